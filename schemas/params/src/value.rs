//! Types of parameters and axes: reading, checks, and canonical spelling.

use std::collections::BTreeMap;

use crate::{ChoiceRegistry, Fault, Literal, Param, ParamDoc, ParamReader, Rule};

/// Permitted type of a parameter.
pub trait ParamValue: Sized {
    /// The name of the type in the reference.
    const TYPE: &'static str;

    /// The type in words, with the types of its elements.
    fn type_words() -> String {
        Self::TYPE.to_owned()
    }

    /// The permitted words of a [`choice!`](crate::choice!); empty for other types.
    const WORDS: &'static [&'static str] = &[];

    /// The value of a literal; `None` if the type does not fit.
    fn read(literal: &Literal) -> Option<Self>;

    /// Value of an unset parameter without a default.
    fn absent() -> Option<Self> {
        None
    }

    /// Checks that the value obeys the rule.
    ///
    /// # Errors
    /// Fails if it does not; the fault lists the permitted values.
    fn check(&self, rule: &Rule) -> Result<(), Fault>;

    /// Canonical spelling for the key of a result: `0.10` and `0.1` are equal; `1` and `"1"` differ.
    fn canonical(&self) -> String;

    /// Reads the parameter `param` of the current group. Returns `None` if it is invalid or missing; the reader then
    /// holds the fault.
    fn obtain(reader: &mut ParamReader, param: Param<Self>) -> Option<Self> {
        reader.plain(param)
    }

    /// Documentation in the reference: one entry, unless the value has keys.
    fn document(doc: ParamDoc, _lists: &ChoiceRegistry) -> Vec<ParamDoc> {
        vec![doc]
    }

    /// Adds its canonical spelling: one pair, unless the value has keys.
    fn spell(&self, name: &'static str, out: &mut Vec<(&'static str, String)>) {
        out.push((name, self.canonical()));
    }
}

impl ParamValue for f64 {
    const TYPE: &'static str = "number";

    fn read(literal: &Literal) -> Option<f64> {
        match literal {
            Literal::Float(x) => Some(*x),
            // Above 2^53, conversion would change a whole number silently.
            Literal::Int(x) if x.unsigned_abs() <= 1 << 53 => Some(*x as f64),
            _ => None,
        }
    }

    fn check(&self, rule: &Rule) -> Result<(), Fault> {
        rule.number(*self)
    }

    fn canonical(&self) -> String {
        // -0.0 and 0.0 are equal.
        format!("{:?}", self + 0.0)
    }
}

/// Number, or `"auto"` for an estimate from the data.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NumberOrAuto {
    /// Estimated from the data.
    Auto,
    /// This number.
    Given(f64),
}

impl NumberOrAuto {
    /// The number, if one is given.
    pub fn given(self) -> Option<f64> {
        match self {
            NumberOrAuto::Auto => None,
            NumberOrAuto::Given(x) => Some(x),
        }
    }
}

impl From<f64> for NumberOrAuto {
    fn from(x: f64) -> NumberOrAuto {
        NumberOrAuto::Given(x)
    }
}

impl ParamValue for NumberOrAuto {
    const TYPE: &'static str = "number or `auto`";

    fn read(literal: &Literal) -> Option<NumberOrAuto> {
        match literal {
            Literal::Text(word) => (word == "auto").then_some(NumberOrAuto::Auto),
            number => f64::read(number).map(NumberOrAuto::Given),
        }
    }

    fn check(&self, rule: &Rule) -> Result<(), Fault> {
        self.given().map_or(Ok(()), |x| x.check(rule))
    }

    fn canonical(&self) -> String {
        self.given().map_or("auto".to_owned(), |x| x.canonical())
    }
}

impl ParamValue for usize {
    const TYPE: &'static str = "whole number";

    fn read(literal: &Literal) -> Option<usize> {
        if let Literal::Int(x) = literal { usize::try_from(*x).ok() } else { None }
    }

    fn check(&self, rule: &Rule) -> Result<(), Fault> {
        rule.number(*self as f64)
    }

    fn canonical(&self) -> String {
        self.to_string()
    }
}

impl ParamValue for u16 {
    const TYPE: &'static str = "whole number below 65536";

    fn read(literal: &Literal) -> Option<u16> {
        if let Literal::Int(x) = literal { u16::try_from(*x).ok() } else { None }
    }

    fn check(&self, rule: &Rule) -> Result<(), Fault> {
        rule.number(f64::from(*self))
    }

    fn canonical(&self) -> String {
        self.to_string()
    }
}

/// Text as written in a file, such as `N/A` or -99999; a number keeps its spelling.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct VerbatimText(pub String);

impl From<&str> for VerbatimText {
    fn from(text: &str) -> VerbatimText {
        VerbatimText(text.to_owned())
    }
}

impl ParamValue for VerbatimText {
    const TYPE: &'static str = "text or number";

    fn read(literal: &Literal) -> Option<VerbatimText> {
        match literal {
            Literal::Text(_) | Literal::Int(_) | Literal::Float(_) => Some(VerbatimText(literal.to_string())),
            Literal::Bool(_) | Literal::List(_) | Literal::Section(_) => None,
        }
    }

    fn check(&self, rule: &Rule) -> Result<(), Fault> {
        rule.word(&self.0)
    }

    fn canonical(&self) -> String {
        format!("{:?}", self.0)
    }
}

impl ParamValue for bool {
    const TYPE: &'static str = "boolean";

    fn read(literal: &Literal) -> Option<bool> {
        if let Literal::Bool(x) = literal { Some(*x) } else { None }
    }

    fn check(&self, _: &Rule) -> Result<(), Fault> {
        Ok(())
    }

    fn canonical(&self) -> String {
        self.to_string()
    }
}

impl ParamValue for String {
    const TYPE: &'static str = "text";

    fn read(literal: &Literal) -> Option<String> {
        literal.as_text().map(str::to_owned)
    }

    fn check(&self, rule: &Rule) -> Result<(), Fault> {
        rule.word(self)
    }

    fn canonical(&self) -> String {
        format!("{self:?}")
    }
}

impl<T: ParamValue> ParamValue for Vec<T> {
    const TYPE: &'static str = "list";

    fn type_words() -> String {
        format!("list of {}", several(&T::type_words()))
    }

    const WORDS: &'static [&'static str] = T::WORDS;

    fn read(literal: &Literal) -> Option<Vec<T>> {
        match literal {
            Literal::List(items) => items.iter().map(T::read).collect(),
            one => T::read(one).map(|x| vec![x]),
        }
    }

    fn check(&self, rule: &Rule) -> Result<(), Fault> {
        self.iter().try_for_each(|x| x.check(rule))
    }

    fn canonical(&self) -> String {
        format!("[{}]", self.iter().map(T::canonical).collect::<Vec<_>>().join(","))
    }
}

impl<T: ParamValue> ParamValue for Option<T> {
    const TYPE: &'static str = T::TYPE;

    fn type_words() -> String {
        T::type_words()
    }

    const WORDS: &'static [&'static str] = T::WORDS;

    fn read(literal: &Literal) -> Option<Option<T>> {
        T::read(literal).map(Some)
    }

    fn absent() -> Option<Option<T>> {
        Some(None)
    }

    fn check(&self, rule: &Rule) -> Result<(), Fault> {
        self.as_ref().map_or(Ok(()), |x| x.check(rule))
    }

    fn canonical(&self) -> String {
        self.as_ref().map_or("none".to_owned(), T::canonical)
    }

    fn obtain(reader: &mut ParamReader, param: Param<Self>) -> Option<Self> {
        if reader.given(param.name).is_none() {
            return param.absent.or(Some(None));
        }
        T::obtain(reader, Param { name: param.name, rule: param.rule, doc: param.doc, absent: None }).map(Some)
    }

    fn document(doc: ParamDoc, lists: &ChoiceRegistry) -> Vec<ParamDoc> {
        T::document(doc, lists)
    }

    fn spell(&self, name: &'static str, out: &mut Vec<(&'static str, String)>) {
        match self {
            Some(value) => value.spell(name, out),
            None => out.push((name, self.canonical())),
        }
    }
}

impl<T: ParamValue, const N: usize> ParamValue for [T; N] {
    const TYPE: &'static str = "list";

    fn type_words() -> String {
        format!("list of {N} {}", several(&T::type_words()))
    }

    fn read(literal: &Literal) -> Option<[T; N]> {
        let Literal::List(items) = literal else { return None };
        items.iter().map(T::read).collect::<Option<Vec<T>>>()?.try_into().ok()
    }

    fn check(&self, rule: &Rule) -> Result<(), Fault> {
        self.iter().try_for_each(|x| x.check(rule))
    }

    fn canonical(&self) -> String {
        format!("[{}]", self.iter().map(T::canonical).collect::<Vec<_>>().join(","))
    }
}

/// The plural of the name of a type.
fn several(words: &str) -> String {
    match words.split_once(" of ") {
        Some((first, rest)) => format!("{first}s of {rest}"),
        None => format!("{words}s"),
    }
}

/// Values with names that are not known in advance, such as the names of electric currents.
impl<T: ParamValue> ParamValue for BTreeMap<String, T> {
    const TYPE: &'static str = "table";

    fn read(literal: &Literal) -> Option<Self> {
        let Literal::Section(section) = literal else { return None };
        section.keys.iter().map(|(key, given)| Some((key.clone(), T::read(&given.value)?))).collect()
    }

    fn obtain(reader: &mut ParamReader, param: Param<Self>) -> Option<Self> {
        if let Some(Literal::Section(section)) = reader.given(param.name).map(|given| &given.value)
            && let Some((key, given)) = section.keys.iter().find(|(_, given)| T::read(&given.value).is_none())
        {
            reader.wrong_type(&format!("{}.{key}", param.name), &T::type_words(), given);
            return None;
        }
        reader.plain(param)
    }

    fn check(&self, rule: &Rule) -> Result<(), Fault> {
        self.values().try_for_each(|x| x.check(rule))
    }

    fn canonical(&self) -> String {
        format!("{{{}}}", self.iter().map(|(k, x)| format!("{k:?}:{}", x.canonical())).collect::<Vec<_>>().join(","))
    }
}

/// Declares a choice among words: an `enum` that is read from its word in the spec, so that later code compares no
/// text.
///
/// ```
/// use params::{Literal, ParamValue, choice};
/// choice! {
///     /// Interpolation between the nodes.
///     pub enum Between {
///         /// A straight line.
///         Linear = "linear",
///         /// A polynomial of third degree.
///         Cubic = "cubic",
///     }
/// }
/// assert_eq!(Between::read(&Literal::Text("cubic".into())), Some(Between::Cubic));
/// assert_eq!(Between::Linear.word(), "linear");
/// ```
#[macro_export]
macro_rules! choice {
    (
        $(#[$d:meta])*
        $v:vis enum $Ty:ident { $( $(#[$vd:meta])* $V:ident = $word:literal ),+ $(,)? }
    ) => {
        $(#[$d])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        $v enum $Ty { $( $(#[$vd])* $V, )+ }

        impl $Ty {
            /// The word in the spec.
            pub const fn word(self) -> &'static str {
                match self { $( $Ty::$V => $word, )+ }
            }
        }

        impl $crate::ParamValue for $Ty {
            const TYPE: &'static str = "text";
            const WORDS: &'static [&'static str] = &[$($word),+];

            fn read(literal: &$crate::Literal) -> Option<$Ty> {
                let word = literal.as_text()?;
                [$($Ty::$V),+].into_iter().find(|choice| choice.word() == word)
            }

            fn check(&self, _: &$crate::Rule) -> Result<(), $crate::Fault> {
                Ok(())
            }

            fn canonical(&self) -> String {
                format!("{:?}", self.word())
            }
        }
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_equal_values_have_one_canonical_spelling() {
        let canonical = |l: Literal| f64::read(&l).map(|x| x.canonical());
        assert_eq!(canonical(Literal::Float(0.1)), canonical(Literal::Float(1.0e-1)));
        assert_eq!(canonical(Literal::Int(1)), canonical(Literal::Float(1.0)));
        assert_eq!(canonical(Literal::Float(-0.0)), canonical(Literal::Float(0.0)));
        assert_eq!(canonical(Literal::Text("1".into())), None);
    }

    #[test]
    fn unit_auto_is_read_and_numbers_keep_their_spelling() {
        let read = |l: Literal| NumberOrAuto::read(&l);
        assert_eq!(read(Literal::Text("auto".into())), Some(NumberOrAuto::Auto));
        assert_eq!(read(Literal::Text("atuo".into())), None);
        assert_eq!(read(Literal::Int(5)).map(|x| x.canonical()), Some(5.0.canonical()));
        assert!(
            NumberOrAuto::Given(0.0).check(&Rule::Positive).is_err()
                && NumberOrAuto::Auto.check(&Rule::Positive).is_ok()
        );
        assert_ne!(NumberOrAuto::Auto.canonical(), NumberOrAuto::Given(0.0).canonical());
    }

    #[test]
    fn unit_rules_reject_values_outside_their_limits() {
        assert!(f64::NAN.check(&Rule::Any).is_err());
        assert!(0.0.check(&Rule::Positive).is_err());
        assert!(f64::INFINITY.check(&Rule::NotNegative).is_err());
        assert!(13usize.check(&Rule::Between(1.0, 12.0)).is_err());
        let fault = "linaer".to_owned().check(&Rule::OneOf(&["linear", "cubic"])).err();
        assert_eq!(fault.and_then(|f| f.help).as_deref(), Some("did you mean `linear`?"));
    }
}
