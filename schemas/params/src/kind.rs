//! Choices among named alternatives, each with separate keys, such as the models of a fit.

use std::{any::Any, fmt, sync::Arc};

use crate::{Fault, Literal, Param, ParamDoc, ParamReader, ParamValue, Params, Rule};

/// One of several choices that a key selects by name. The keys of a choice are in the same table as the key that
/// selects it. A key of another choice is rejected; if the choice is a value of an axis, such a key has no effect.
pub trait ChoiceKind: Send + Sync + 'static {
    /// The selected choice, with its keys.
    type Keys: ?Sized + Send + Sync + 'static;

    /// The default choice; `None` if the key is required.
    const DEFAULT: Option<&'static str>;

    /// Name in a spec.
    fn name(&self) -> &'static str;

    /// Version, raised when the results change.
    fn version(&self) -> u32;

    /// Hash of the source text of a choice that is loaded at run time. The hash is part of the keys of results. `None`
    /// for a compiled choice, whose version changes with its results.
    fn source(&self) -> Option<&str> {
        None
    }

    /// Its own keys, for the reference.
    fn docs(&self) -> Vec<ParamDoc> {
        vec![]
    }

    /// Keys of the surrounding table that this choice uses and some other choices do not use.
    fn takes(&self) -> &'static [&'static str] {
        &[]
    }

    /// Reads its own keys. Returns `None` if there are faults; the reader then holds them.
    fn read(&self, reader: &mut ParamReader) -> Option<ChoiceKeys<Self::Keys>>;
}

/// The spelling of a choice in a key: its name, its version if above 1, and the hash of its source if it has one.
fn spelt<K: ChoiceKind>(kind: &K) -> String {
    let named = match kind.version() {
        1 => format!("{:?}", kind.name()),
        version => format!("{:?} version {version}", kind.name()),
    };
    kind.source().map(|source| format!("{named} source {source}")).unwrap_or(named)
}

/// Keys of a choice.
pub struct ChoiceKeys<T: ?Sized> {
    /// Values of the keys, in the type that the choice uses.
    pub keys: Arc<T>,
    /// Keys in canonical spelling.
    pub spelt: Vec<(&'static str, String)>,
}

impl<T: ?Sized> ChoiceKeys<T> {
    /// Reads the group `P`, which `keys` converts to `T`.
    pub fn read<P: Params>(reader: &mut ParamReader, keys: fn(P) -> Arc<T>) -> Option<ChoiceKeys<T>> {
        let (group, mut spelt) = (P::read(reader, None)?, vec![]);
        group.spell(&mut spelt);
        Some(ChoiceKeys { keys: keys(group), spelt })
    }
}

/// All choices of a list, with the keys of each.
pub struct ChoiceList<K: 'static> {
    all: Vec<&'static K>,
    names: Vec<&'static str>,
    keys: Vec<Vec<&'static str>>,
}

impl<K: ChoiceKind> ChoiceList<K> {
    /// A list of choices.
    pub fn new(all: Vec<&'static K>) -> ChoiceList<K> {
        let names = all.iter().map(|kind| kind.name()).collect();
        let own = |kind: &&K| kind.docs().iter().map(|d| d.name).chain(kind.takes().iter().copied()).collect();
        ChoiceList { names, keys: all.iter().map(own).collect(), all }
    }

    /// The list that the key `name` selects from.
    fn from_reader(reader: &mut ParamReader, name: &str) -> Option<Arc<ChoiceList<K>>> {
        let kinds = reader.lists.get();
        if kinds.is_none() {
            reader.push(Fault::bug(format!("`{name}` of `{}` has no list", reader.owner)));
        }
        kinds
    }

    /// Names of all choices, for a message.
    fn words(&self) -> String {
        self.names.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ")
    }

    /// All choices in the order of the reference.
    pub fn all(&self) -> &[&'static K] {
        &self.all
    }

    /// The choice with this name.
    pub fn find(&self, name: &str) -> Option<&'static K> {
        self.all.iter().copied().find(|kind| kind.name() == name)
    }

    /// Names of the choices that own the key.
    pub fn owners(&self, key: &str) -> Vec<&'static str> {
        self.names.iter().zip(&self.keys).filter(|(_, keys)| keys.contains(&key)).map(|(name, _)| *name).collect()
    }

    /// Reason why `key` has no effect with `kind`; `None` if it has an effect.
    fn foreign(&self, kind: &K, key: &str) -> Option<Fault> {
        let takes = self.names.iter().position(|name| *name == kind.name()).map(|i| &self.keys[i]);
        if takes.is_some_and(|keys| keys.contains(&key)) || !self.keys.iter().any(|keys| keys.contains(&key)) {
            return None;
        }
        let names: Vec<String> = self.owners(key).iter().map(|name| format!("`{name}`")).collect();
        let names = match names.split_last() {
            Some((last, rest)) if !rest.is_empty() => format!("{} and {last}", rest.join(", ")),
            _ => names.concat(),
        };
        let what = format!("`{key}` belongs to {names}");
        Some(Fault::new(what).help(format!("remove `{key}`, which has no effect with `{}`", kind.name())))
    }
}

/// Lists of choices of a catalogue, each identified by its type.
#[derive(Clone, Default)]
pub struct ChoiceRegistry(Vec<Arc<dyn Any + Send + Sync>>);

impl ChoiceRegistry {
    /// Adds a list.
    pub fn with<K: ChoiceKind>(mut self, all: Vec<&'static K>) -> ChoiceRegistry {
        self.0.push(Arc::new(ChoiceList::new(all)));
        self
    }

    /// The list of a type.
    pub fn get<K: ChoiceKind>(&self) -> Option<Arc<ChoiceList<K>>> {
        self.0.iter().find_map(|list| list.clone().downcast::<ChoiceList<K>>().ok())
    }
}

/// Selected choice, with its keys.
pub struct ChoiceSelection<K: ChoiceKind> {
    /// Declaration.
    pub kind: &'static K,
    /// Keys.
    pub keys: Arc<K::Keys>,
    spelt: Vec<(&'static str, String)>,
    kinds: Arc<ChoiceList<K>>,
}

impl<K: ChoiceKind> ChoiceSelection<K> {
    /// Selection of a choice with these keys, made outside a spec. Its keys have no canonical spelling, and the list
    /// contains no other choice.
    pub fn new(kind: &'static K, keys: Arc<K::Keys>) -> Self {
        Self { kind, keys, spelt: vec![], kinds: Arc::new(ChoiceList::new(vec![kind])) }
    }

    /// Reason why `key` has no effect with the selected choice: it belongs to other choices. `None` if it has an
    /// effect.
    pub fn foreign(&self, key: &str) -> Option<Fault> {
        self.kinds.foreign(self.kind, key)
    }

    /// Whether the selected choice, or every choice, uses `key`.
    pub fn takes(&self, key: &str) -> bool {
        self.foreign(key).is_none()
    }
}

impl<K: ChoiceKind> Clone for ChoiceSelection<K> {
    fn clone(&self) -> Self {
        Self { kind: self.kind, keys: self.keys.clone(), spelt: self.spelt.clone(), kinds: self.kinds.clone() }
    }
}

impl<K: ChoiceKind> fmt::Debug for ChoiceSelection<K> {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{} {:?}", self.kind.name(), self.spelt)
    }
}

impl<K: ChoiceKind> PartialEq for ChoiceSelection<K> {
    fn eq(&self, other: &Self) -> bool {
        (self.kind.name(), &self.spelt) == (other.kind.name(), &other.spelt)
    }
}

impl<K: ChoiceKind> ParamValue for ChoiceSelection<K> {
    const TYPE: &'static str = "text";

    fn read(_: &Literal) -> Option<Self> {
        None
    }

    fn check(&self, _: &Rule) -> Result<(), Fault> {
        Ok(())
    }

    fn canonical(&self) -> String {
        spelt(self.kind)
    }

    fn obtain(reader: &mut ParamReader, param: Param<Self>) -> Option<Self> {
        let kinds = ChoiceList::<K>::from_reader(reader, param.name)?;
        let name = match (reader.given(param.name), K::DEFAULT) {
            (None, Some(default)) => default,
            (None, None) => {
                reader.missing(param.name, param.doc);
                return None;
            }
            (Some(given), _) => match given.value.as_text() {
                Some(word) => word,
                None => {
                    reader.wrong_type(param.name, Self::TYPE, given);
                    return None;
                }
            },
        };
        let Some(kind) = kinds.find(name) else {
            if let Some(given) = reader.given(param.name) {
                reader.wrong_choice(param.name, name, &kinds.names, given);
            } else {
                reader.push(Fault::bug(format!("`{}` has no `{name}`", param.name)));
            }
            return None;
        };
        let own = kind.read(reader)?;
        Some(ChoiceSelection { kind, keys: own.keys, spelt: own.spelt, kinds })
    }

    fn document(doc: ParamDoc, lists: &crate::ChoiceRegistry) -> Vec<ParamDoc> {
        let Some(kinds) = lists.get::<K>() else { return vec![doc] };
        let rule = kinds.words();
        let default = K::DEFAULT.map(|name| format!("{name:?}"));
        let mut docs = vec![ParamDoc { rule, default, ..doc }];
        for own in kinds.all.iter().flat_map(|kind| kind.docs()) {
            if !docs.iter().any(|known| known.name == own.name) {
                docs.push(ParamDoc { owners: kinds.owners(own.name), ..own });
            }
        }
        docs
    }

    fn spell(&self, name: &'static str, out: &mut Vec<(&'static str, String)>) {
        out.push((name, self.canonical()));
        out.extend(self.spelt.iter().cloned());
    }
}

/// Subset of a list of choices, by name and without keys; all choices if unset.
pub struct ChoiceSubset<K: ChoiceKind> {
    named: Option<Vec<&'static K>>,
    kinds: Arc<ChoiceList<K>>,
}

impl<K: ChoiceKind> ChoiceSubset<K> {
    /// Selection from a list: the `named` choices, or all compiled choices. A choice that is loaded at run time is
    /// selected only by name, so that loading it does not change other results.
    pub fn new(kinds: Arc<ChoiceList<K>>, named: Option<Vec<&'static K>>) -> ChoiceSubset<K> {
        ChoiceSubset { named, kinds }
    }

    /// The selected choices, in the order of the list.
    pub fn wanted(&self) -> impl Iterator<Item = &'static K> + '_ {
        let is_wanted = |kind: &&'static K| match &self.named {
            Some(named) => named.iter().any(|named| named.name() == kind.name()),
            None => kind.source().is_none(),
        };
        self.kinds.all.iter().copied().filter(is_wanted)
    }

    /// The choices that the user named, in the given order; empty if unset.
    pub fn named(&self) -> &[&'static K] {
        self.named.as_deref().unwrap_or_default()
    }

    /// All choices of the list.
    pub fn all(&self) -> &[&'static K] {
        &self.kinds.all
    }
}

impl<K: ChoiceKind> Clone for ChoiceSubset<K> {
    fn clone(&self) -> Self {
        Self { named: self.named.clone(), kinds: self.kinds.clone() }
    }
}

impl<K: ChoiceKind> fmt::Debug for ChoiceSubset<K> {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(&self.canonical())
    }
}

impl<K: ChoiceKind> PartialEq for ChoiceSubset<K> {
    fn eq(&self, other: &Self) -> bool {
        self.canonical() == other.canonical()
    }
}

impl<K: ChoiceKind> ParamValue for ChoiceSubset<K> {
    const TYPE: &'static str = "list";

    fn read(_: &Literal) -> Option<Self> {
        None
    }

    fn check(&self, _: &Rule) -> Result<(), Fault> {
        Ok(())
    }

    fn canonical(&self) -> String {
        // The spelling contains all selected choices, so that an addition to the list changes the key.
        let all = self.named.clone().unwrap_or_else(|| self.wanted().collect());
        format!("[{}]", all.into_iter().map(spelt).collect::<Vec<_>>().join(","))
    }

    fn obtain(reader: &mut ParamReader, param: Param<Self>) -> Option<Self> {
        let kinds = ChoiceList::<K>::from_reader(reader, param.name)?;
        let Some(given) = reader.given(param.name) else { return Some(ChoiceSubset { named: None, kinds }) };
        let Some(words) = Vec::<String>::read(&given.value) else {
            reader.wrong_type(param.name, Self::TYPE, given);
            return None;
        };
        let find = |word: &String| {
            let found = kinds.find(word);
            if found.is_none() {
                reader.wrong_choice(param.name, word, &kinds.names, given);
            }
            found
        };
        let named: Vec<Option<&'static K>> = words.iter().map(find).collect();
        Some(ChoiceSubset { named: Some(named.into_iter().collect::<Option<_>>()?), kinds })
    }

    fn document(doc: ParamDoc, lists: &crate::ChoiceRegistry) -> Vec<ParamDoc> {
        let Some(kinds) = lists.get::<K>() else { return vec![doc] };
        vec![ParamDoc { rule: kinds.words(), ..doc }]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{SpecEntries, SpecEntry, params};

    params! {
        /// Fits.
        struct Straight;
        /// The degree.
        degree: usize, unit "", default 1usize;
    }

    struct Curve(&'static str);

    impl ChoiceKind for Curve {
        type Keys = dyn Any + Send + Sync;
        const DEFAULT: Option<&'static str> = Some("straight");

        fn name(&self) -> &'static str {
            self.0
        }

        fn version(&self) -> u32 {
            if self.0 == "flat" { 2 } else { 1 }
        }

        fn source(&self) -> Option<&str> {
            (self.0 == "loaded").then_some("5f2e")
        }

        fn docs(&self) -> Vec<ParamDoc> {
            if self.0 == "straight" { Straight::docs(&ChoiceRegistry::default()) } else { vec![] }
        }

        fn read(&self, reader: &mut ParamReader) -> Option<ChoiceKeys<Self::Keys>> {
            if self.0 != "straight" {
                return Some(ChoiceKeys { keys: Arc::new(()), spelt: vec![] });
            }
            ChoiceKeys::read::<Straight>(reader, |keys| Arc::new(keys))
        }
    }

    params! {
        /// A stage.
        struct Stage;
        /// The curve.
        curve: ChoiceSelection<Curve>, unit "";
        /// More curves.
        curves: ChoiceSubset<Curve>, unit "", absent "all";
    }

    fn read(given: &[(&str, Literal)]) -> Result<Stage, Vec<Fault>> {
        let lists = ChoiceRegistry::default().with(vec![&Curve("straight"), &Curve("flat")]);
        let one = |(key, value): &(&str, Literal)| {
            ((*key).to_owned(), SpecEntry { value: value.clone(), key_at: 0..0, at: 0..0 })
        };
        let args: SpecEntries = given.iter().map(one).collect();
        let mut reader = ParamReader::new("stage", &args, None, &lists);
        let stage = Stage::read(&mut reader, None);
        let known: Vec<&str> = Stage::docs(&lists).iter().map(|d| d.name).collect();
        reader.unknown_keys(&known, &[]);
        let faults = reader.into_faults();
        stage.filter(|_| faults.is_empty()).ok_or(faults)
    }

    fn text(word: &str) -> Literal {
        Literal::Text(word.to_owned())
    }

    #[test]
    fn unit_a_key_of_another_choice_has_no_effect() {
        let stage = read(&[("curve", text("flat")), ("degree", Literal::Int(3))]).unwrap();
        let mut spelt = vec![];
        stage.spell(&mut spelt);
        assert_eq!(
            spelt,
            [("curve", "\"flat\" version 2".to_owned()), ("curves", "[\"straight\",\"flat\" version 2]".to_owned())]
        );
        assert_eq!(stage.curve.foreign("degree").unwrap().what, "`degree` belongs to `straight`");
        assert!(stage.curve.takes("curves") && read(&[]).unwrap().curve.takes("degree"));
        assert_eq!(super::spelt(&Curve("loaded")), "\"loaded\" source 5f2e");
    }

    #[test]
    fn unit_unknown_names_are_reported_with_the_nearest_name() {
        let faults = read(&[("curve", text("flut")), ("curves", text("straigth"))]).unwrap_err();
        assert_eq!(
            faults.iter().map(|f| f.what.as_str()).collect::<Vec<_>>(),
            ["`curve` cannot be `flut`", "`curves` cannot be `straigth`"]
        );
        assert!(faults.iter().all(|f| f.help.as_deref().is_some_and(|h| h.starts_with("did you mean"))));
        assert_eq!(
            read(&[("curves", text("flat"))]).unwrap().curves.wanted().map(|c| c.0).collect::<Vec<_>>(),
            ["flat"]
        );
    }
}
