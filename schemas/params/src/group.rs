//! Groups of parameters, and their reader.

use std::ops::Range;

use crate::{ChoiceRegistry, Fault, Literal, ParamValue, Rule, SpecEntries, SpecEntry, SpecSection};

/// A parameter as the reference shows it.
#[derive(Clone, Debug)]
pub struct ParamDoc {
    /// The key in the spec.
    pub name: &'static str,
    /// The name of the type.
    pub type_name: &'static str,
    /// The unit; empty for none.
    pub unit: &'static str,
    /// The default in canonical spelling; `None` for a required or an optional parameter.
    pub default: Option<String>,
    /// Behaviour of an unset parameter without a default; `None` if it is required.
    pub absent: Option<&'static str>,
    /// Permitted values, in words.
    pub rule: String,
    /// Effect of the parameter.
    pub doc: String,
    /// The [kinds](crate::ChoiceKind) that own the key; empty for a key of all kinds.
    pub owners: Vec<&'static str>,
    /// The keys inside a table or a list of tables.
    pub keys: Vec<ParamDoc>,
}

impl ParamDoc {
    /// Row of the parameter in a table of the reference: key, type, unit, default, allowed values and meaning. `within`
    /// is a prefix of the key.
    pub fn row(&self, within: &str) -> String {
        let default = match (self.default.as_deref(), self.absent) {
            (Some(default), _) => format!("`{default}`"),
            (None, Some(text)) => format!("unset: {text}"),
            (None, None) => "must be given".to_owned(),
        };
        let ParamDoc { name, type_name, unit, rule, .. } = self;
        let doc = self.doc.replace("\n\n", " ");
        format!("| `{within}{name}` | {type_name} | {unit} | {default} | {rule} | {doc} |\n")
    }
}

/// A parameter of a group, as its reader needs it.
pub struct Param<'a, T> {
    /// The key.
    pub name: &'static str,
    /// Condition on its value.
    pub rule: Rule,
    /// Documentation, shown as the remedy if the key is missing.
    pub doc: &'a [&'a str],
    /// The value if unset; `None` if required.
    pub absent: Option<T>,
}

/// A group of parameters, as [`params!`](crate::params!) declares it.
pub trait Params: Sized {
    /// Reads the group. The values of `base`, if any, replace the defaults. Returns `None` if there are faults; the
    /// reader then holds them.
    fn read(reader: &mut ParamReader, base: Option<&Self>) -> Option<Self>;

    /// Parameters, for the reference.
    fn docs(lists: &ChoiceRegistry) -> Vec<ParamDoc>;

    /// Adds every parameter to `out`, in canonical spelling.
    fn spell(&self, out: &mut Vec<(&'static str, String)>);

    /// Checks that every value obeys its rule, for a group that was not read from a spec.
    ///
    /// # Errors
    /// Fails with the first violation.
    fn check(&self) -> Result<(), Fault>;
}

/// Reader of the keys of one table; collects all their faults.
pub struct ParamReader<'a> {
    /// Name that messages give to the owner of the keys, which is a stage or a table.
    pub owner: &'a str,
    /// The lists of [kinds](crate::ChoiceKind) that values are selected from.
    pub lists: &'a ChoiceRegistry,
    args: &'a SpecEntries,
    at: Option<Range<usize>>,
    faults: Vec<Fault>,
}

impl<'a> ParamReader<'a> {
    /// Reader of the keys `args` of the table at the byte range `at`.
    pub fn new(
        owner: &'a str,
        args: &'a SpecEntries,
        at: Option<Range<usize>>,
        lists: &'a ChoiceRegistry,
    ) -> ParamReader<'a> {
        ParamReader { owner, lists, args, at, faults: vec![] }
    }

    /// The entry of a key; `None` if the table does not contain it.
    pub fn given(&self, name: &str) -> Option<&'a SpecEntry> {
        self.args.get(name)
    }

    /// Adds a fault of the whole table.
    pub fn push(&mut self, fault: Fault) {
        self.faults.push(self.at.iter().cloned().fold(fault, Fault::at));
    }

    /// All faults.
    pub fn into_faults(self) -> Vec<Fault> {
        self.faults
    }

    /// Adds the fault of a missing required key.
    pub fn missing(&mut self, name: &str, doc: &[&str]) {
        self.push(Fault::new(format!("`{}` needs `{name}`", self.owner)).help(collect_doc(doc)));
    }

    /// Adds the fault of a value of another type.
    pub fn wrong_type(&mut self, name: &str, wanted: &str, given: &SpecEntry) {
        let article = if wanted.starts_with(['a', 'e', 'i', 'o']) { "an" } else { "a" };
        let is_number = |item: &&Literal| matches!(item, Literal::Int(_) | Literal::Float(_));
        let found = match &given.value {
            Literal::Int(_) | Literal::Float(_) => given.value.to_string(),
            Literal::List(items) => match items.iter().find(|item| !is_number(item)).or(items.first()) {
                Some(Literal::Text(word)) if wanted.contains("number") => format!("a list with the text `{word}`"),
                _ => format!("a list of {}", items.len()),
            },
            other => format!("a {}", other.type_name()),
        };
        let what = format!("`{name}` of `{}` must be {article} {wanted}, not {found}", self.owner);
        self.faults.push(Fault::new(what).at(given.at.clone()));
    }

    /// Adds the fault of a word that is not in `known`.
    pub fn wrong_word(&mut self, name: &str, word: &str, known: &[&str], given: &SpecEntry) {
        self.faults.push(Fault::new(format!("`{name}` cannot be `{word}`")).nearest(word, known).at(given.at.clone()));
    }

    /// Same as [`ParamReader::wrong_word`], for the name of a part that may be written in Python, such as a model.
    pub fn wrong_choice(&mut self, name: &str, word: &str, known: &[&str], given: &SpecEntry) {
        let fault = Fault::new(format!("`{name}` cannot be `{word}`")).nearest_part(word, known);
        self.faults.push(fault.at(given.at.clone()));
    }

    /// Reads a value that has no keys.
    pub fn plain<T: ParamValue>(&mut self, param: Param<T>) -> Option<T> {
        let Param { name, rule, doc, absent } = param;
        let Some(given) = self.given(name) else {
            if absent.is_none() {
                self.missing(name, doc);
            }
            return absent;
        };
        let Some(value) = T::read(&given.value) else {
            let words = match &given.value {
                Literal::List(items) => items.as_slice(),
                one => std::slice::from_ref(one),
            };
            let other = |word: &&str| !T::WORDS.is_empty() && !T::WORDS.contains(word);
            match words.iter().filter_map(Literal::as_text).find(other) {
                Some(word) => self.wrong_word(name, word, T::WORDS, given),
                None => self.wrong_type(name, &T::type_words(), given),
            }
            return None;
        };
        match obeys(&value, name, rule) {
            Ok(()) => Some(value),
            Err(fault) => {
                self.faults.push(fault.at(given.at.clone()));
                None
            }
        }
    }

    /// Adds a fault for each key that is not in `known`. `more` are keys of other owners that a message may suggest.
    pub fn unknown_keys(&mut self, known: &[&str], more: &[&str]) {
        for (name, given) in self.args.iter().filter(|(name, _)| !known.contains(&name.as_str())) {
            let all: Vec<&str> = known.iter().chain(more).copied().collect();
            let what = format!("`{}` has no parameter `{name}`", self.owner);
            self.faults.push(Fault::new(what).nearest(name, &all).at(given.key_at.clone()));
        }
    }

    /// Reads all keys of the table as a group. The values of `base`, if any, replace the defaults. Returns the group,
    /// if its own keys are valid, and all faults, including those of unknown keys.
    pub fn group<T: Params>(mut self, base: Option<&T>) -> (Option<T>, Vec<Fault>) {
        let group = T::read(&mut self, base);
        let known: Vec<&str> = T::docs(self.lists).iter().map(|doc| doc.name).collect();
        self.unknown_keys(&known, &[]);
        (group, self.faults)
    }

    /// Reads a table inside this one as a group.
    pub(crate) fn inside<T: Params>(&mut self, name: &str, section: &SpecSection, base: Option<&T>) -> Option<T> {
        let at = Some(section.at.clone()).filter(|at| !at.is_empty()).or(self.at.clone());
        let (group, faults) = ParamReader::new(name, &section.keys, at, self.lists).group(base);
        let fine = faults.is_empty();
        self.faults.extend(faults);
        group.filter(|_| fine)
    }
}

/// Joins `///` lines as rustdoc does. Keeps paragraphs and the rows of tables.
pub fn collect_doc(lines: &[&str]) -> String {
    let mut text = String::new();
    for line in lines.iter().map(|l| l.trim()) {
        if line.is_empty() {
            text.push_str("\n\n");
        } else {
            if !text.is_empty() && !text.ends_with('\n') {
                text.push(if line.starts_with('|') { '\n' } else { ' ' });
            }
            text.push_str(line);
        }
    }
    text
}

/// Rule for a parameter that declares none: one of the words of its type, if the type has words.
#[doc(hidden)]
pub fn words_rule<T: ParamValue>() -> Rule {
    if T::WORDS.is_empty() { Rule::Any } else { Rule::OneOf(T::WORDS) }
}

/// Checks that the value of the parameter `name` obeys its rule.
#[doc(hidden)]
pub fn obeys<T: ParamValue>(value: &T, name: &str, rule: Rule) -> Result<(), Fault> {
    value.check(&rule).map_err(|fault| Fault { what: format!("`{name}` {}", fault.what), ..fault }.of_param(name))
}

/// First element of a list.
#[doc(hidden)]
pub fn first<T, const N: usize>(list: [T; N]) -> Option<T> {
    list.into_iter().next()
}

/// Returns `None`: a parameter with the default `_default` needs no text for its behaviour when unset.
#[doc(hidden)]
pub const fn no_text(_default: &str) -> Option<&'static str> {
    None
}

/// Declares a group of parameters: a struct whose fields have a unit, default, rule and documentation. `groups` lists
/// other groups whose keys are in the same table. A parameter of type `Option` documents its behaviour when unset
/// (`absent`). With `all default;` every parameter has a default, and the group implements [`Default`].
///
/// ```
/// use params::{SpecEntries, ChoiceRegistry, Params, ParamReader, Rule, params};
/// params! {
///     /// A Butterworth filter.
///     pub struct Band;
///     /// The lower corner.
///     low_hz: f64, unit "Hz", default 0.1, rule Rule::NotNegative;
///     /// The order of the prototype.
///     order: usize, unit "", default 4usize, rule Rule::Between(1.0, 12.0);
/// }
/// let (args, lists) = (SpecEntries::new(), ChoiceRegistry::default());
/// let band = Band::read(&mut ParamReader::new("bandpass", &args, None, &lists), None);
/// assert_eq!(band.map(|b| (b.low_hz, b.order)), Some((0.1, 4)));
/// ```
#[macro_export]
macro_rules! params {
    (
        $(#[doc = $d:literal])*
        $v:vis struct $Ty:ident, all default;
        $(
            $(#[doc = $pd:literal])* $p:ident : $pt:ty, unit $unit:literal, default $def:expr
            $(, absent $absent:literal)? $(, rule $rule:expr)? ;
        )*
    ) => {
        $crate::params! {
            $(#[doc = $d])*
            $v struct $Ty;
            $( $(#[doc = $pd])* $p : $pt, unit $unit, default $def $(, absent $absent)? $(, rule $rule)? ; )*
        }

        impl Default for $Ty {
            fn default() -> Self {
                Self { $( $p: <$pt>::from($def), )* }
            }
        }
    };
    (
        $(#[doc = $d:literal])*
        $v:vis struct $Ty:ident $(, groups [$($(#[doc = $gd:literal])* $g:ident : $gt:ty),* $(,)?])? ;
        $(
            $(#[doc = $pd:literal])* $p:ident : $pt:ty, unit $unit:literal
            $(, default $def:expr)? $(, absent $absent:literal)? $(, rule $rule:expr)? ;
        )*
    ) => {
        $(#[doc = $d])*
        #[derive(Clone, Debug, PartialEq)]
        $v struct $Ty {
            $( $(#[doc = $pd])* pub $p: $pt, )*
            $($( #[doc = concat!("The parameters of [`", stringify!($gt), "`].")] pub $g: $gt, )*)?
        }

        impl $crate::Params for $Ty {
            fn read(reader: &mut $crate::ParamReader, base: Option<&Self>) -> Option<Self> {
                let _ = (&reader, base);
                $(
                    let $p: Option<$pt> = {
                        let left_out = || {
                            let defaults = [$(Some(<$pt>::from($def)),)? <$pt as $crate::ParamValue>::absent()];
                            $crate::first(defaults).flatten()
                        };
                        let absent = base.map(|base| base.$p.clone()).or_else(left_out);
                        let rule = $crate::first([$($rule,)? $crate::Rule::Any]).unwrap_or($crate::Rule::Any);
                        let param = $crate::Param { name: stringify!($p), rule, doc: &[$($pd),*], absent };
                        <$pt as $crate::ParamValue>::obtain(reader, param)
                    };
                )*
                $($( let $g = <$gt as $crate::Params>::read(reader, base.map(|base| &base.$g)); )*)?
                Some($Ty { $( $p: $p?, )* $($( $g: $g?, )*)? })
            }

            fn docs(lists: &$crate::ChoiceRegistry) -> Vec<$crate::ParamDoc> {
                #[allow(unused_mut)]
                let mut docs: Vec<$crate::ParamDoc> = vec![];
                let _ = lists;
                $( docs.extend(<$pt as $crate::ParamValue>::document($crate::ParamDoc {
                    name: stringify!($p),
                    type_name: <$pt as $crate::ParamValue>::TYPE,
                    unit: $unit,
                    default: {
                        let default: Option<$pt> = $crate::first([$(Some(<$pt>::from($def)),)? None]).flatten();
                        let absent_text: Option<&str> = $crate::first([$(Some($absent),)? None]).flatten();
                        default.as_ref().filter(|_| absent_text.is_none()).map($crate::ParamValue::canonical)
                    },
                    absent: $crate::first([
                        $(Some($absent),)?
                        $($crate::no_text(stringify!($def)),)?
                        <$pt as $crate::ParamValue>::absent().map(|_: $pt| ""),
                    ]).flatten(),
                    rule: $crate::first([$($rule,)? $crate::words_rule::<$pt>()])
                        .map(|rule| rule.words())
                        .unwrap_or_default(),
                    doc: $crate::collect_doc(&[$($pd),*]),
                    owners: vec![],
                    keys: vec![],
                }, lists)); )*
                $($( docs.extend(<$gt as $crate::Params>::docs(lists)); )*)?
                docs
            }

            fn check(&self) -> Result<(), $crate::Fault> {
                $(
                    let rule = $crate::first([$($rule,)? $crate::Rule::Any]).unwrap_or($crate::Rule::Any);
                    $crate::obeys(&self.$p, stringify!($p), rule)?;
                )*
                $($( $crate::Params::check(&self.$g)?; )*)?
                Ok(())
            }

            fn spell(&self, out: &mut Vec<(&'static str, String)>) {
                let _ = &out;
                $( $crate::ParamValue::spell(&self.$p, stringify!($p), out); )*
                $($( $crate::Params::spell(&self.$g, out); )*)?
            }
        }
    };
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{NestedParams, ParamsList, choice};

    choice! {
        /// A grade.
        pub enum Grade {
            /// Good.
            Navigation = "navigation",
            /// Poor.
            Tactical = "tactical",
        }
    }

    params! {
        /// Errors.
        pub struct Errors, all default;
        /// A bias.
        bias_m: f64, unit "m", default 3.0, rule Rule::NotNegative;
        /// A heading.
        heading_deg: Option<f64>, unit "deg", default None, absent "that of the tilt";
    }

    params! {
        /// An INS.
        pub struct Ins, groups [errors: Errors];
        /// Its grade.
        grade: Grade, unit "", default Grade::Navigation;
    }

    params! {
        /// A document.
        pub struct Root;
        /// The INS.
        ins: NestedParams<Ins>, unit "";
        /// The lines.
        lines: ParamsList<Errors>, unit "", default Vec::<Errors>::new();
    }

    fn read(text: &str) -> Result<Root, Vec<Fault>> {
        let (document, lists) = (SpecSection::document(text)?, ChoiceRegistry::default());
        let mut reader = ParamReader::new("spec", &document.keys, None, &lists);
        let root = Root::read(&mut reader, None);
        reader.unknown_keys(&["ins", "lines"], &[]);
        let faults = reader.into_faults();
        root.filter(|_| faults.is_empty()).ok_or(faults)
    }

    #[test]
    fn unit_groups_nest_and_lists_keep_their_order() {
        let root = read("[ins]\ngrade = \"tactical\"\nbias_m = 2\n[[lines]]\nbias_m = 1.0\n[[lines]]\n").unwrap();
        assert_eq!((root.ins.0.grade, root.ins.0.errors.bias_m), (Grade::Tactical, 2.0));
        assert_eq!(root.lines.0.iter().map(|l| l.bias_m).collect::<Vec<_>>(), [1.0, 3.0]);
        assert_eq!(read("").unwrap().ins.0.errors, Errors::default());
    }

    #[test]
    fn unit_all_faults_are_reported_with_positions() {
        let text = "[ins]\ngrad = 1\nbias_m = -1\n[[lines]]\nbias_m = \"x\"\n";
        let faults = read(text).unwrap_err();
        let messages: Vec<&str> = faults.iter().map(|f| f.what.as_str()).collect();
        assert_eq!(
            messages,
            [
                "`bias_m` must be 0 or above, not -1",
                "`ins` has no parameter `grad`",
                "`bias_m` of `lines` must be a number, not a text"
            ]
        );
        assert_eq!(faults[1].help.as_deref(), Some("did you mean `grade`?"));
        assert_eq!(&text[faults[1].at.clone().unwrap()], "grad");
    }

    #[test]
    fn unit_base_values_replace_the_defaults() {
        let (args, lists) = (SpecEntries::new(), ChoiceRegistry::default());
        let base = Errors { bias_m: 7.0, heading_deg: Some(1.0) };
        let read = Errors::read(&mut ParamReader::new("ins", &args, None, &lists), Some(&base));
        assert_eq!(read, Some(base));
    }

    #[test]
    fn unit_reference_rows_show_defaults_and_nested_groups() {
        let docs = Ins::docs(&ChoiceRegistry::default());
        assert_eq!(docs.iter().map(|d| d.name).collect::<Vec<_>>(), ["grade", "bias_m", "heading_deg"]);
        assert_eq!(docs[1].default.as_deref(), Some("3.0"));
        assert_eq!((docs[2].default.as_deref(), docs[2].absent), (None, Some("that of the tilt")));
    }
}
