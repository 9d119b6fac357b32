//! Presets: platforms with known sensors and sources, on which a spec can be based.
//!
//! `preset = "cessna"` at the top of a spec adds the preset's keys. A key of the spec overrides the key of the preset.
//! Tables are merged key by key, and lists of tables with a `name` entry by entry: `[[magnetometers]]` with the name
//! `mag_4_uc` and `noise_nt` changes only that noise. An entry of another `kind` replaces the entry of the preset.
//! `without = ["mag_5_uc"]` removes entries by name.

use std::ops::Range;

use schemas::Fault;
use toml::{
    Spanned,
    de::{DeArray, DeTable, DeValue},
};

use super::section::SynthFaultList;

const CESSNA: &str = include_str!("../../presets/cessna.toml");
const DRONE: &str = include_str!("../../presets/drone.toml");

/// The presets by name. Each consists of one or more TOML files, each of which is a spec without map and flights. A
/// later file overrides the earlier files, as a spec overrides its preset. Lists without names, such as wires, are
/// appended.
pub const PRESETS: &[(&str, &[&str])] = &[
    ("cessna", &[CESSNA]),
    ("cessna_real", &[CESSNA, include_str!("../../presets/cessna_real.toml")]),
    ("drone", &[DRONE]),
    ("drone_real", &[DRONE, include_str!("../../presets/drone_real.toml")]),
];

/// Alternative keys for one quantity. If the spec gives one of the two keys, the other key of the preset is removed.
const EITHER: [[&str; 2]; 5] = [
    ["permanent", "permanent_nt"],
    ["induced", "induced_nt"],
    ["eddy", "eddy_s"],
    ["flex", "flex_nt_per_mps2"],
    ["hysteresis", "hysteresis_nt"],
];

/// Treatment of lists without names that occur in both tables.
#[derive(Clone, Copy)]
enum PresetListMerge {
    /// The overriding list replaces the base list.
    Replace,
    /// The entries of the overriding list follow the entries of the base list.
    Append,
}

/// Adds the preset that the spec `root` names, if any. Faults in the preset's values are reported at the name of the
/// preset in the spec.
pub(crate) fn applied<'a>(mut root: DeTable<'a>, faults: &SynthFaultList) -> DeTable<'a> {
    let without = root.remove("without").map(|value| left_out(&value, faults)).unwrap_or_default();
    let Some(named) = root.remove("preset") else {
        if let Some((_, at)) = without.first() {
            faults.borrow_mut().push(Fault::new("`without` removes entries of a preset; set `preset`").at(at.clone()));
        }
        return root;
    };
    let fault = |fault: Fault| faults.borrow_mut().push(fault.at(named.span()));
    let Some(name) = named.get_ref().as_str() else {
        fault(Fault::new("`preset` must be the name of a preset"));
        return root;
    };
    let names: Vec<&str> = PRESETS.iter().map(|(name, _)| *name).collect();
    let Some((_, texts)) = PRESETS.iter().find(|(known, _)| *known == name) else {
        fault(Fault::new(format!("there is no preset `{name}`")).nearest(name, &names));
        return root;
    };
    let mut base = DeTable::new();
    for text in *texts {
        match DeTable::parse(text) {
            Ok(layer) => base = merged(base, placed(layer.into_inner(), &named.span()), PresetListMerge::Append),
            Err(error) => {
                fault(Fault::new(format!("the preset `{name}` is invalid: {}", error.message())));
                return root;
            }
        }
    }
    for (gone, at) in without {
        if !leave_out(&mut base, &gone) {
            let known = entries(&base);
            let what = format!("the preset `{name}` has no `{gone}`");
            faults.borrow_mut().push(Fault::new(what).at(at).nearest(&gone, &known));
        }
    }
    merged(base, root, PresetListMerge::Replace)
}

fn left_out(value: &Spanned<DeValue>, faults: &SynthFaultList) -> Vec<(String, Range<usize>)> {
    let one = |v: &Spanned<DeValue>| v.get_ref().as_str().map(|s| (s.to_owned(), v.span()));
    let found: Option<Vec<_>> = value.get_ref().as_array().and_then(|list| list.iter().map(one).collect());
    found.unwrap_or_else(|| {
        faults.borrow_mut().push(Fault::new("`without` must be a list of names").at(value.span()));
        vec![]
    })
}

/// The name of an entry of a list of tables.
fn name_of<'b>(value: &'b Spanned<DeValue>) -> Option<&'b str> {
    value.get_ref().as_table()?.get("name")?.get_ref().as_str()
}

fn entries(table: &DeTable) -> Vec<String> {
    let lists = table.values().filter_map(|v| v.get_ref().as_array());
    lists.flat_map(|list| list.iter().filter_map(name_of)).map(str::to_owned).collect()
}

/// Removes the entries named `name` and all references to the name, such as the wires of a current of this name.
fn leave_out(table: &mut DeTable, name: &str) -> bool {
    let is = |value: &Spanned<DeValue>, key: &str| {
        let found = value.get_ref().as_table().and_then(|t| t.get(key));
        found.is_some_and(|v| v.get_ref().as_str() == Some(name))
    };
    let mut found = false;
    for (_, value) in table.iter_mut() {
        let DeValue::Array(list) = value.get_mut() else { continue };
        let kept = std::mem::replace(list, DeArray::new()).into_iter().filter(|entry| {
            found |= is(entry, "name");
            !["name", "current", "of"].iter().any(|key| is(entry, key))
        });
        *list = kept.collect::<Vec<_>>().into_iter().collect();
        for entry in list.iter_mut() {
            let DeValue::Table(entry) = entry.get_mut() else { continue };
            for key in ["currents", "ohm", "crosstalk"] {
                if let Some(DeValue::Table(couplings)) = entry.get_mut(key).map(Spanned::get_mut) {
                    couplings.remove(name);
                }
            }
        }
    }
    found
}

/// Returns the same values, all with the same position in the spec.
fn placed<'a>(table: DeTable<'a>, at: &Range<usize>) -> DeTable<'a> {
    let one = |(key, value): (Spanned<std::borrow::Cow<'a, str>>, Spanned<DeValue<'a>>)| {
        (Spanned::new(at.clone(), key.into_inner()), placed_value(value, at))
    };
    table.into_iter().map(one).collect()
}

fn placed_value<'a>(value: Spanned<DeValue<'a>>, at: &Range<usize>) -> Spanned<DeValue<'a>> {
    let inner = match value.into_inner() {
        DeValue::Table(table) => DeValue::Table(placed(table, at)),
        DeValue::Array(list) => DeValue::Array(list.into_iter().map(|v| placed_value(v, at)).collect()),
        other => other,
    };
    Spanned::new(at.clone(), inner)
}

/// The keys of the two tables; `over` takes precedence over `base`.
fn merged<'a>(mut base: DeTable<'a>, over: DeTable<'a>, unnamed: PresetListMerge) -> DeTable<'a> {
    for [one, other] in EITHER {
        if over.contains_key(one) || over.contains_key(other) {
            base.remove(one);
            base.remove(other);
        }
    }
    for (key, value) in over {
        let value = match base.remove(key.get_ref().as_ref()) {
            Some(below) => merged_value(below, value, unnamed),
            None => value,
        };
        base.insert(key, value);
    }
    base
}

fn merged_value<'a>(
    below: Spanned<DeValue<'a>>,
    over: Spanned<DeValue<'a>>,
    unnamed: PresetListMerge,
) -> Spanned<DeValue<'a>> {
    let at = over.span();
    let value = match (below.into_inner(), over.into_inner()) {
        (DeValue::Table(below), DeValue::Table(over)) => DeValue::Table(merged(below, over, unnamed)),
        (DeValue::Array(below), DeValue::Array(over)) if below.iter().all(|v| name_of(v).is_some()) => {
            DeValue::Array(merged_entries(below, over, unnamed))
        }
        (DeValue::Array(below), DeValue::Array(over)) if unnamed.appends(&over) => {
            DeValue::Array(below.into_iter().chain(over).collect())
        }
        (_, over) => over,
    };
    Spanned::new(at, value)
}

/// Entries of the same name are merged in the order of `below`. New entries of `over` follow.
fn merged_entries<'a>(below: DeArray<'a>, over: DeArray<'a>, unnamed: PresetListMerge) -> DeArray<'a> {
    let mut over: Vec<Option<Spanned<DeValue<'a>>>> = over.into_iter().map(Some).collect();
    let mut out = vec![];
    for entry in below {
        let same = over.iter_mut().find(|o| o.as_ref().is_some_and(|o| name_of(o) == name_of(&entry)));
        out.push(match same.and_then(Option::take) {
            Some(changed) if is_of_another_kind(&entry, &changed) => changed,
            Some(changed) => merged_value(entry, changed, unnamed),
            None => entry,
        });
    }
    out.into_iter().chain(over.into_iter().flatten()).collect()
}

impl PresetListMerge {
    /// Whether the entries of `over` are appended: for a list of tables, but not for a vector.
    fn appends(self, over: &DeArray) -> bool {
        matches!(self, PresetListMerge::Append)
            && !over.is_empty()
            && over.iter().all(|v| v.get_ref().as_table().is_some())
    }
}

fn is_of_another_kind(one: &Spanned<DeValue>, other: &Spanned<DeValue>) -> bool {
    let kind = |v: &Spanned<DeValue>| -> Option<String> {
        Some(v.get_ref().as_table()?.get("kind")?.get_ref().as_str()?.to_owned())
    };
    kind(other).is_some_and(|k| Some(k) != kind(one))
}

#[cfg(test)]
mod tests;
