//! Reads the tables of a spec, and collects the faults of its form.

use std::{collections::BTreeMap, path::PathBuf};

use buckets::{ObjectAddress, StorageLocation, cache, place, supported};
use schemas::{Fault, Literal, SpecEntries, SpecEntry, SpecSection, paths};
use toml::{
    Spanned,
    de::{DeTable, DeValue},
};

use super::{
    STAGE_KEYS, SearchSpec, SearchState, SourceDecl, Spec, SpecSpan, StageDecl, SweepAxis, TOP, argument, axis, faults,
    literal, plain,
    publish::{self, ProtectionKeys, PublishFacts},
    search,
    set::SetAssignment,
    several,
};

/// Maximum number of stages, which limits the depth of the plan, because each stage may be a separate level. A spec
/// with more stages should use an axis instead.
const MOST_STAGES: usize = 1_000;

fn given(value: Literal, key_at: SpecSpan, at: SpecSpan) -> SpecEntry {
    SpecEntry { value, key_at, at }
}

/// Reader of a spec.
#[derive(Default)]
pub(super) struct SpecParser {
    pub(super) faults: Vec<Fault>,
}

impl SpecParser {
    /// Reads the spec; `None` if the faults prevent it.
    pub(super) fn document(&mut self, file: &str, folder: PathBuf, text: &str, sets: &[String]) -> Option<Spec> {
        let starts = faults::starts(text, sets);
        let mut assignments = vec![];
        for (set, start) in sets.iter().zip(starts) {
            match SetAssignment::new(set, start) {
                Ok(assignment) => assignments.push(assignment),
                Err(fault) => self.faults.push(fault),
            }
        }
        let mut root = match DeTable::parse(text) {
            Ok(root) => root.into_inner(),
            Err(e) => {
                let fault = Fault::new(e.message().to_owned());
                self.faults.push(match e.span() {
                    Some(at) => fault.at(at),
                    None => fault,
                });
                return None;
            }
        };
        for assignment in &assignments {
            if let Err(fault) = assignment.put(&mut root) {
                self.faults.push(fault);
            }
        }
        let spec = self.spec(&root, file, folder, text)?;
        Some(Spec { sets: sets.to_vec(), ..spec })
    }

    fn spec(&mut self, root: &DeTable, file: &str, folder: PathBuf, text: &str) -> Option<Spec> {
        for (key, _) in root.iter() {
            if !TOP.contains(&key.get_ref().as_ref()) {
                let fault = Fault::new(format!("a spec has no key `{}`", key.get_ref()));
                self.faults.push(fault.nearest(key.get_ref(), &TOP).at(key.span()));
            }
        }
        let name = self.name_of(root, file);
        let seed = self.seed(root);
        let (store, store_at) = self.store(root);
        let tables = self.named(root, "tables").iter().filter_map(|(n, v)| self.source(n, v)).collect();
        let tables = several::tables(tables, &mut self.faults);
        let axes: Vec<SweepAxis> = self.named(root, "axes").iter().filter_map(|(n, v)| self.axis(n, v)).collect();
        let search = self.search(root, seed, &axes);
        let stages = self.stages(root);
        let publish = self.publish(root);
        let store = folder.join(store);
        let listed = axes.len();
        let spec = Spec {
            file: file.to_owned(),
            store,
            store_at,
            folder,
            text: text.to_owned(),
            sets: vec![],
            name: name?,
            seed,
            tables,
            axes,
            searched: listed..listed,
            search,
            trials: vec![],
            stages,
            publish,
            verify_inputs: false,
            settle: None,
        };
        // The first trials do not depend on any scores.
        let first = spec.search.as_ref().map(|search| SearchState::new(search).rows());
        Some(match first {
            Some(rows) => spec.with_trials(&rows),
            None => spec,
        })
    }

    /// The table `search`.
    fn search(&mut self, root: &DeTable, seed: u64, listed: &[SweepAxis]) -> Option<SearchSpec> {
        let search = search::read(root.get("search")?, seed, listed).map_err(|f| self.faults.extend(f)).ok()?;
        for (name, at) in search.columns() {
            self.identifier(name, at.clone());
        }
        Some(search)
    }

    /// The name of the pipeline: as given in the spec, or the stem of the file's name.
    fn name_of(&mut self, root: &DeTable, file: &str) -> Option<String> {
        let stem = || PathBuf::from(file).file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
        let (name, at) = self.text(root, "name").unwrap_or_else(|| (stem(), 0..0));
        self.identifier(&name, at).then_some(name)
    }

    /// The store's folder as given in the spec; or the folder of the store's copy, and the store's address.
    fn store(&mut self, root: &DeTable) -> (PathBuf, Option<(ObjectAddress, SpecSpan)>) {
        let Some((store, at)) = self.text(root, "store") else { return ("store".into(), None) };
        if store.contains("://") {
            let found = place(&store).and_then(|place| match place {
                StorageLocation::Path(path) => Ok((path, None)),
                StorageLocation::Object(address) => {
                    supported()?;
                    Ok((cache::of_store(&address)?, Some((address, at.clone()))))
                }
            });
            return found.unwrap_or_else(|fault| {
                // The value may be a password, so it is not shown.
                self.faults.push(if store.contains('@') { fault } else { fault.at(at) });
                ("store".into(), None)
            });
        }
        let wrong = if store.trim().is_empty() {
            Some("give a folder such as `store`; `.` is the folder of the spec")
        } else if store.chars().any(char::is_control) {
            Some("give a folder without control characters such as line breaks")
        } else if store.split(['/', '\\']).any(|part| part.len() > paths::LONGEST_PART) {
            Some("give a folder whose path has at most 255 bytes in each part")
        } else {
            None
        };
        if let Some(help) = wrong {
            self.faults.push(Fault::new(format!("the store `{}` is not a folder", plain(&store))).help(help).at(at));
        }
        (store.into(), None)
    }

    /// The table `publish`.
    fn publish(&mut self, root: &DeTable) -> Option<Result<PublishFacts, Vec<Fault>>> {
        let value = root.get("publish")?;
        let Some(table) = value.get_ref().as_table() else {
            self.faults.push(Fault::new("`publish` must be a table: `[publish]`").at(value.span()));
            return None;
        };
        Some(SpecSection::from_table(table, value.span()).and_then(|section| publish::read_facts(&section)))
    }

    fn seed(&mut self, root: &DeTable) -> u64 {
        let Some(value) = root.get("seed") else { return 0 };
        match literal(value) {
            Ok(Literal::Int(n)) if n >= 0 => n.unsigned_abs(),
            _ => {
                self.faults.push(Fault::new("`seed` must be a whole number, 0 or above").at(value.span()));
                0
            }
        }
    }

    /// Names become folders and SQL identifiers, so they are kept plain.
    fn identifier(&mut self, name: &str, at: SpecSpan) -> bool {
        if let Err(help) = paths::check_name(name) {
            let long = name.is_ascii() && name.len() > paths::LONGEST_NAME;
            let what = if long {
                format!("the name is too long: it has {} characters", name.len())
            } else {
                format!("`{}` cannot be a name", plain(name))
            };
            self.faults.push(Fault::new(what).at(at).help(help));
            return false;
        }
        true
    }

    fn text(&mut self, table: &DeTable, key: &str) -> Option<(String, SpecSpan)> {
        let value = table.get(key)?;
        match value.get_ref().as_str() {
            Some(text) => Some((text.to_owned(), value.span())),
            None => {
                self.faults.push(Fault::new(format!("`{key}` must be text")).at(value.span()));
                None
            }
        }
    }

    /// The entries of the table `key`, in the order of the file.
    fn named<'a>(&mut self, root: &'a DeTable, key: &str) -> Vec<(Spanned<String>, &'a Spanned<DeValue<'a>>)> {
        let Some(value) = root.get(key) else { return vec![] };
        let Some(table) = value.get_ref().as_table() else {
            self.faults.push(Fault::new(format!("`{key}` must be a table")).at(value.span()));
            return vec![];
        };
        let mut entries: Vec<_> =
            table.iter().map(|(k, v)| (Spanned::new(k.span(), k.get_ref().to_string()), v)).collect();
        entries.sort_by_key(|(k, _)| k.span().start);
        entries
    }

    fn source(&mut self, name: &Spanned<String>, value: &Spanned<DeValue>) -> Option<SourceDecl> {
        self.identifier(name.get_ref(), name.span());
        let Some(table) = value.get_ref().as_table() else {
            let fault = Fault::new(format!("the table `{}` must be a TOML table with `path = ...`", name.get_ref()));
            self.faults.push(fault.at(value.span()));
            return None;
        };
        let Some(path) = self.text(table, "path") else {
            if !table.contains_key("path") {
                self.faults
                    .push(Fault::new(format!("the table `{}` requires a `path`", name.get_ref())).at(name.span()));
            }
            return None;
        };
        let mut options = match SpecSection::from_table(table, value.span()) {
            Ok(section) => section.keys,
            Err(faults) => {
                self.faults.extend(faults);
                return None;
            }
        };
        options.remove("path");
        let protection = match ProtectionKeys::take(name.get_ref(), &mut options, name.span()) {
            Ok(protection) => protection,
            Err(faults) => {
                self.faults.extend(faults);
                return None;
            }
        };
        Some(SourceDecl { name: name.get_ref().clone(), at: name.span(), path, protection, options })
    }

    fn axis(&mut self, name: &Spanned<String>, value: &Spanned<DeValue>) -> Option<SweepAxis> {
        self.identifier(name.get_ref(), name.span());
        match axis::values(name.get_ref(), value) {
            Ok(values) => Some(SweepAxis { name: name.get_ref().clone(), at: name.span(), values }),
            Err(faults) => {
                self.faults.extend(faults);
                None
            }
        }
    }

    fn stages(&mut self, root: &DeTable) -> Vec<StageDecl> {
        let Some(value) = root.get("stages") else {
            self.faults.push(Fault::new("the spec has no stages").help("add a `[[stages]]` table"));
            return vec![];
        };
        let Some(items) = value.get_ref().as_array() else {
            self.faults.push(Fault::new("`stages` must be an array of tables: `[[stages]]`").at(value.span()));
            return vec![];
        };
        if items.len() > MOST_STAGES {
            let what = format!("the spec has {} stages; at most {MOST_STAGES} are permitted", items.len());
            self.faults.push(Fault::new(what).at(value.span()).help("use an axis to run a stage several times"));
            return vec![];
        }
        items.iter().filter_map(|item| self.stage(item)).collect()
    }

    fn stage(&mut self, item: &Spanned<DeValue>) -> Option<StageDecl> {
        let Some(table) = item.get_ref().as_table() else {
            self.faults.push(Fault::new("a stage must be a table").at(item.span()));
            return None;
        };
        let mut need = |key: &str, why: &str| {
            let found = self.text(table, key);
            if found.is_none() && !table.contains_key(key) {
                self.faults.push(Fault::new(format!("a stage requires `{key}`: {why}")).at(item.span()));
            }
            found
        };
        let name = need("name", "the name of the table that it makes");
        let stage = need("stage", "the kind of stage");
        let predicate = self.text(table, "where");
        let (publish, _) = self.choice(table, "publish");
        let keep = self.choice(table, "keep");
        let carry = self.carry(table);
        let args = self.args(table, &STAGE_KEYS.map(|(key, _)| key));
        let (name, at) = name?;
        self.identifier(&name, at.clone());
        Some(StageDecl { name, at, stage: stage?, predicate, publish, carry, keep, args })
    }

    /// The boolean key `key` of a stage; default true.
    fn choice(&mut self, table: &DeTable, key: &str) -> (bool, SpecSpan) {
        let Some(value) = table.get(key) else { return (true, 0..0) };
        let chosen = value.get_ref().as_bool();
        if chosen.is_none() {
            self.faults.push(Fault::new(format!("`{key}` must be true or false")).at(value.span()));
        }
        (chosen.unwrap_or(true), value.span())
    }

    /// The names of a stage's `carry`.
    fn carry(&mut self, table: &DeTable) -> Vec<(String, SpecSpan)> {
        let Some(value) = table.get("carry") else { return vec![] };
        let items = value.get_ref().as_array();
        let names = items.and_then(|items| {
            items
                .iter()
                .map(|v| v.get_ref().as_str().map(|name| (name.to_owned(), v.span())))
                .collect::<Option<Vec<_>>>()
        });
        names.unwrap_or_else(|| {
            let fault = Fault::new("`carry` must be a list of column names").at(value.span());
            self.faults.push(fault.help("write for example `carry = [\"lat\", \"lon\"]`"));
            vec![]
        })
    }

    fn args(&mut self, table: &DeTable, but: &[&str]) -> SpecEntries {
        let mut args: SpecEntries = BTreeMap::new();
        for (key, value) in table.iter().filter(|(k, _)| !but.contains(&k.get_ref().as_ref())) {
            match argument(value) {
                Ok(x) => {
                    args.insert(key.get_ref().to_string(), given(x, key.span(), value.span()));
                }
                Err(fault) => self.faults.push(fault),
            }
        }
        args
    }
}
