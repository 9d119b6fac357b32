//! `--set KEY=VALUE`: values of the command line, inserted into the document before it is checked.

use std::borrow::Cow;

use schemas::Fault;
use toml::{
    Spanned,
    de::{DeString, DeTable, DeValue},
};

use super::{SpecSpan, TOP, publish::PROTECTION_KEYS};

/// Keys whose value is always a string and therefore needs no quotes.
const TEXT_KEYS: [&str; 5] = ["name", "store", "path", "stage", "where"];

/// One assignment as two TOML documents, padded so that their byte positions continue after the spec's text.
pub struct SetAssignment {
    /// The whole assignment, which may be valid TOML or not.
    whole: String,
    /// The key with the value 0, so that the key can be parsed even if the assigned value is not TOML.
    key: String,
    /// The bytes of the value.
    value: SpecSpan,
    /// The bytes of the assignment.
    at: SpecSpan,
}

impl SetAssignment {
    /// The assignment `text`, whose first byte is `start`.
    ///
    /// # Errors
    /// Fails if it has no `=`.
    pub fn new(text: &str, start: usize) -> Result<SetAssignment, Fault> {
        let at = start..start + text.len();
        let equals = equals(text).ok_or_else(|| form(&at))?;
        let room = " ".repeat(start);
        let raw = &text[equals + 1..];
        let from = start + equals + 1 + (raw.len() - raw.trim_start().len());
        let value = from..(start + text.trim_end().len()).max(from);
        Ok(SetAssignment { whole: format!("{room}{text}"), key: format!("{room}{}=0", &text[..equals]), value, at })
    }

    /// Sets the value in the document `root`.
    ///
    /// # Errors
    /// Fails if the key does not exist in the spec, or the value is not TOML where TOML is required.
    pub fn put<'i>(&'i self, root: &mut DeTable<'i>) -> Result<(), Fault> {
        let path = self.path()?;
        let value = self.value(&path)?;
        let names: Vec<&str> = path.iter().map(word).collect();
        match names.as_slice() {
            ["name" | "seed" | "store"] => {
                put(root, &path, value);
                Ok(())
            }
            ["axes", _] => match table(root.get_mut("axes")) {
                Some(axes) => inside(axes, &path[1..], value, "axis"),
                None => Err(unknown("axis", &path[1], &[])),
            },
            ["tables", table, key, ..] if PROTECTION_KEYS.contains(key) => {
                let what =
                    format!("`--set` cannot change `{key}` of `{table}`: restrictions are declared only in the spec");
                Err(Fault::new(what).at(self.span_of(&path)).help("change the key in the spec"))
            }
            ["tables", _, _, ..] => match table(root.get_mut("tables")) {
                Some(tables) => inside(tables, &path[1..], value, "table"),
                None => Err(unknown("table", &path[1], &[])),
            },
            ["publish", _] | ["search", _, ..] => {
                put(root, &path, value);
                Ok(())
            }
            ["stages", _, _, ..] => stage(root, &path[1..], value),
            [first, _, ..] if !TOP.contains(first) => stage(root, &path, value),
            [_, ..] => Err(Fault::new(format!("`--set` cannot set `{}`", names.join(".")))
                .at(self.span_of(&path))
                .help("use name, seed, store, axes.NAME, search.KEY, tables.NAME.KEY, publish.KEY or STAGE.PARAMETER")),
            [] => Err(form(&self.at)),
        }
    }

    /// The key's parts.
    fn path(&self) -> Result<Vec<Spanned<DeString<'_>>>, Fault> {
        let Ok(root) = DeTable::parse(&self.key) else { return Err(form(&self.at)) };
        let mut path = vec![];
        let mut level = Some(root.into_inner());
        while let Some(table) = level {
            let mut entries = table.into_iter();
            let (Some((key, value)), None) = (entries.next(), entries.next()) else { return Err(form(&self.at)) };
            path.push(key);
            level = match value.into_inner() {
                DeValue::Table(deeper) => Some(deeper),
                _ => None,
            };
        }
        Ok(path)
    }

    fn span_of(&self, path: &[Spanned<DeString>]) -> SpecSpan {
        path.first().map_or(self.at.start, |k| k.span().start)..path.last().map_or(self.at.end, |k| k.span().end)
    }

    /// The value, parsed as TOML if possible, else the text unchanged.
    fn value(&self, path: &[Spanned<DeString>]) -> Result<Spanned<DeValue<'_>>, Fault> {
        let raw = &self.whole[self.value.clone()];
        let text = || Ok(Spanned::new(self.value.clone(), DeValue::String(Cow::Borrowed(raw))));
        let keeps_text = path.last().is_some_and(|k| TEXT_KEYS.contains(&word(k)));
        match DeTable::parse(&self.whole) {
            Ok(root) => match leaf(root.into_inner(), path) {
                Some(value) => match value.get_ref() {
                    DeValue::Datetime(_) => text(),
                    DeValue::Integer(_) | DeValue::Float(_) | DeValue::Boolean(_) if keeps_text => text(),
                    _ => Ok(value),
                },
                None => Err(form(&self.at)),
            },
            Err(e) if raw.starts_with(['[', '{']) && !keeps_text => {
                let at = e.span().filter(|at| self.at.start <= at.start && at.end <= self.at.end);
                Err(Fault::new(e.message().to_owned()).at(at.unwrap_or(self.value.clone())))
            }
            Err(_) => text(),
        }
    }
}

fn word<'a>(key: &'a Spanned<DeString>) -> &'a str {
    key.get_ref()
}

/// The position of the first `=` outside of quotes.
fn equals(text: &str) -> Option<usize> {
    let mut quote = None;
    text.char_indices().find_map(|(i, c)| {
        match (c, quote) {
            ('=', None) => return Some(i),
            ('"' | '\'', None) => quote = Some(c),
            (c, Some(q)) if c == q => quote = None,
            _ => {}
        }
        None
    })
}

fn form(at: &SpecSpan) -> Fault {
    Fault::new("`--set` requires KEY=VALUE").at(at.clone()).help("write for example `seed=7` or `clean.detrend=true`")
}

/// The value at `path`, if it is the only value there.
fn leaf<'i>(root: DeTable<'i>, path: &[Spanned<DeString>]) -> Option<Spanned<DeValue<'i>>> {
    let (first, rest) = path.split_first()?;
    let mut entries = root.into_iter();
    let (Some((key, value)), None) = (entries.next(), entries.next()) else { return None };
    if key.get_ref() != first.get_ref() {
        return None;
    }
    match (rest.is_empty(), value) {
        (true, value) => Some(value),
        (false, value) => match value.into_inner() {
            DeValue::Table(deeper) => leaf(deeper, rest),
            _ => None,
        },
    }
}

fn table<'a, 'i>(value: Option<&'a mut Spanned<DeValue<'i>>>) -> Option<&'a mut DeTable<'i>> {
    match value.map(Spanned::get_mut) {
        Some(DeValue::Table(table)) => Some(table),
        _ => None,
    }
}

fn unknown(kind: &str, key: &Spanned<DeString>, known: &[&str]) -> Fault {
    let name = word(key);
    Fault::new(format!("there is no {kind} `{name}`")).nearest(name, known).at(key.span())
}

/// Sets the value at `path` below an existing entry.
fn inside<'i>(
    of: &mut DeTable<'i>,
    path: &[Spanned<DeString<'i>>],
    value: Spanned<DeValue<'i>>,
    kind: &str,
) -> Result<(), Fault> {
    let Some(first) = path.first() else { return Ok(()) };
    if !of.contains_key(word(first)) {
        let known: Vec<&str> = of.keys().map(word).collect();
        return Err(unknown(kind, first, &known));
    }
    put(of, path, value);
    Ok(())
}

/// Sets a key of the stage that `path` begins with.
fn stage<'i>(root: &mut DeTable<'i>, path: &[Spanned<DeString<'i>>], value: Spanned<DeValue<'i>>) -> Result<(), Fault> {
    let Some((name, rest)) = path.split_first() else { return Ok(()) };
    let stages = match root.get_mut("stages").map(Spanned::get_mut) {
        Some(DeValue::Array(stages)) => stages,
        _ => return Err(unknown("stage", name, &[])),
    };
    let called = |stage: &Spanned<DeValue>| {
        let name = stage.get_ref().as_table().and_then(|t| t.get("name"));
        name.and_then(|n| n.get_ref().as_str()).map(str::to_owned)
    };
    let known: Vec<Option<String>> = stages.iter().map(called).collect();
    match known.iter().position(|n| n.as_deref() == Some(word(name))) {
        Some(i) => {
            if let Some(stage) = table(stages.get_mut(i)) {
                put(stage, rest, value);
            }
            Ok(())
        }
        None => Err(unknown("stage", name, &known.iter().flatten().map(String::as_str).collect::<Vec<_>>())),
    }
}

/// Sets the value at `path`, and creates missing tables on the way to it.
fn put<'i>(of: &mut DeTable<'i>, path: &[Spanned<DeString<'i>>], value: Spanned<DeValue<'i>>) {
    let Some((first, rest)) = path.split_first() else { return };
    let name = word(first);
    if rest.is_empty() {
        match of.get_mut(name) {
            Some(there) => *there = value,
            None => {
                of.insert(first.clone(), value);
            }
        }
        return;
    }
    if table(of.get_mut(name)).is_none() {
        // A value that is not a table is replaced by a table that holds the longer key.
        let empty = Spanned::new(first.span(), DeValue::Table(DeTable::new()));
        match of.get_mut(name) {
            Some(there) => *there = empty,
            None => {
                of.insert(first.clone(), empty);
            }
        }
    }
    if let Some(deeper) = table(of.get_mut(name)) {
        put(deeper, rest, value);
    }
}
