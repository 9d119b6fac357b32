//! Reads one table of a spec: checks the type and rule of every value, finds unknown keys, and collects all faults
//! so that they are reported together.

use std::{cell::RefCell, ops::Range, rc::Rc};

use schemas::{ChoiceKind, ChoiceRegistry, ChoiceSelection, Fault, ParamReader, Params};
use toml::{
    Spanned,
    de::{DeTable, DeValue},
};

/// The faults found so far.
pub(crate) type SynthFaultList = Rc<RefCell<Vec<Fault>>>;

/// One table of the spec.
pub(crate) struct SynthSection<'a> {
    name: &'static str,
    table: &'a DeTable<'a>,
    span: Range<usize>,
    asked: RefCell<Vec<&'static str>>,
    faults: SynthFaultList,
}

impl<'a> SynthSection<'a> {
    pub(crate) fn new(name: &'static str, table: &'a DeTable<'a>, span: Range<usize>, faults: &SynthFaultList) -> Self {
        Self { name, table, span, asked: RefCell::default(), faults: faults.clone() }
    }

    /// Reads all keys of the table as a group of parameters, with the values of `base`, if given, as defaults.
    pub(crate) fn group<T: Params>(&self, base: Option<&T>) -> Option<T> {
        self.group_of(base, &ChoiceRegistry::default())
    }

    /// Same as [`SynthSection::group`], with the lists of kinds for keys that choose a kind.
    pub(crate) fn group_of<T: Params>(&self, base: Option<&T>, lists: &ChoiceRegistry) -> Option<T> {
        let section = match schemas::SpecSection::from_table(self.table, self.span.clone()) {
            Ok(section) => section,
            Err(faults) => {
                self.faults.borrow_mut().extend(faults);
                return None;
            }
        };
        let (group, faults) = ParamReader::new(self.name, &section.keys, Some(self.span.clone()), lists).group(base);
        self.faults.borrow_mut().extend(faults);
        group
    }

    /// Reads a group from a table that also has other keys, which are read later.
    pub(crate) fn some_keys<T: Params>(&self) -> Option<T> {
        let lists = ChoiceRegistry::default();
        let names: Vec<&'static str> = T::docs(&lists).iter().map(|doc| doc.name).collect();
        let mut own = DeTable::new();
        for (key, value) in self.table.iter().filter(|(key, _)| names.contains(&key.get_ref().as_ref())) {
            own.insert(key.clone(), value.clone());
        }
        self.asked.borrow_mut().extend(names);
        SynthSection::new(self.name, &own, self.span.clone(), &self.faults).group(None)
    }

    /// Rejects keys of kinds other than the chosen one.
    pub(crate) fn refuse_foreign<K: ChoiceKind>(&self, chosen: &ChoiceSelection<K>) {
        for key in self.table.keys() {
            if let Some(fault) = chosen.foreign(key.get_ref()) {
                self.push(fault.at(key.span()));
            }
        }
    }

    /// Byte range of the key `name` in `table`, which is a table inside this table.
    pub(crate) fn key_at(&self, table: &str, name: &str) -> Range<usize> {
        let inner = self.table.get(table).and_then(|value| value.get_ref().as_table());
        let key = inner.and_then(|inner| inner.keys().find(|key| key.get_ref() == name));
        key.map_or(self.span.clone(), Spanned::span)
    }

    /// Records a fault of the whole table.
    pub(crate) fn fault(&self, what: String) {
        self.faults.borrow_mut().push(Fault::new(what).at(self.span.clone()));
    }

    /// Records a fault of the value of `key`.
    pub(crate) fn fault_at(&self, key: &'static str, what: String) {
        self.push_at(key, Fault::new(what));
    }

    fn get(&self, key: &'static str) -> Option<&'a Spanned<DeValue<'a>>> {
        self.asked.borrow_mut().push(key);
        self.table.iter().find(|(k, _)| k.get_ref() == key).map(|(_, v)| v)
    }

    fn wrong(&self, key: &str, value: &Spanned<DeValue>, need: &str) {
        let what = format!("`{key}` of `{}` must be {need}", self.name);
        self.faults.borrow_mut().push(Fault::new(what).at(value.span()));
    }

    /// Reads a value that is true or false, with a default.
    pub(crate) fn flag(&self, key: &'static str, default: bool) -> bool {
        let Some(value) = self.get(key) else { return default };
        value.get_ref().as_bool().unwrap_or_else(|| {
            self.wrong(key, value, "true or false");
            default
        })
    }

    /// The number of faults of the spec so far.
    pub(crate) fn faults(&self) -> usize {
        self.faults.borrow().len()
    }

    /// A table inside this table.
    pub(crate) fn section(&self, name: &'static str) -> Option<SynthSection<'a>> {
        let value = self.get(name)?;
        match value.get_ref() {
            DeValue::Table(table) => Some(SynthSection::new(name, table, value.span(), &self.faults)),
            _ => {
                self.wrong(name, value, "a table");
                None
            }
        }
    }

    /// The tables of a list, such as `[[flights]]`.
    pub(crate) fn sections(&self, name: &'static str) -> Vec<SynthSection<'a>> {
        let Some(value) = self.get(name) else { return vec![] };
        let Some(list) = value.get_ref().as_array() else {
            self.wrong(name, value, "a list of tables");
            return vec![];
        };
        let one = |v: &'a Spanned<DeValue<'a>>| match v.get_ref() {
            DeValue::Table(table) => Some(SynthSection::new(name, table, v.span(), &self.faults)),
            _ => {
                self.wrong(name, v, "a list of tables");
                None
            }
        };
        list.iter().filter_map(one).collect()
    }

    /// Records a fault at the value of `key`.
    pub(crate) fn push_at(&self, key: &'static str, fault: Fault) {
        let at = self.get(key).map_or(self.span.clone(), Spanned::span);
        self.push(fault.at(at));
    }

    /// Records a fault that already has a position in the spec.
    pub(crate) fn push(&self, fault: Fault) {
        self.faults.borrow_mut().push(fault);
    }

    /// Records every unknown key, with the nearest known key.
    pub(crate) fn finish(&self) {
        let asked = self.asked.borrow();
        for key in self.table.keys().filter(|k| !asked.contains(&k.get_ref().as_ref())) {
            let mut known = asked.clone();
            known.sort_unstable();
            known.dedup();
            let what = format!("`{}` has no key `{}`", self.name, key.get_ref());
            self.push(Fault::new(what).at(key.span()).nearest(key.get_ref(), &known));
        }
    }
}

/// Records duplicate names.
pub(crate) fn unique(root: &SynthSection, kind: &str, names: impl Iterator<Item = String>) {
    let names: Vec<String> = names.collect();
    for (i, name) in names.iter().enumerate() {
        if names.iter().take(i).any(|n| n == name) {
            root.fault(format!("the {kind} `{name}` is defined twice"));
        }
    }
}
