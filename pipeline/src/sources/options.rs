//! The options of a `[tables.NAME]` of the spec in addition to its path.

use std::collections::BTreeMap;

use datasets::{FlightOptions, MapOptions};
use schemas::{Args, Fault, Literal, Value, plausible::Accept};

use crate::spec::SourceDecl;

/// The options of a table of flights.
///
/// # Errors
/// Fails for unknown options and wrong types.
pub fn flight_options(decl: &SourceDecl) -> Result<FlightOptions, Vec<Fault>> {
    let known = ["format", "flight", "line", "rename", "units", "missing", "accept", "epsg"];
    let mut read = Read::new(decl, &known, "a table of flight lines");
    let (format, epsg): (Option<String>, Option<u16>) = (read.get("format"), read.epsg());
    if epsg.is_some() && format.as_deref() != Some("points") {
        read.wrong("epsg", "`epsg` is of survey points alone: say `format = \"points\"`".to_owned());
    }
    let options = FlightOptions {
        format,
        epsg,
        rename: read.table("rename"),
        units: read.table("units"),
        missing: read.words("missing"),
        flight: read.get("flight"),
        line: read.get("line"),
        accept: read.accepted(),
    };
    read.finish(options)
}

/// The options of a map.
///
/// # Errors
/// Fails for unknown options and wrong types.
pub fn map_options(decl: &SourceDecl) -> Result<MapOptions, Vec<Fault>> {
    let mut read = Read::new(decl, &["format", "epsg", "alt_m", "unit"], "a map");
    let epsg = read.epsg();
    let options = MapOptions { format: read.get("format"), epsg, alt_m: read.get("alt_m"), unit: read.get("unit") };
    read.finish(options)
}

/// All options in one spelling, for keys.
pub fn spelt(decl: &SourceDecl) -> String {
    decl.options.iter().map(|(k, v)| format!("{k}={};", v.value)).collect()
}

fn word(value: &Literal) -> Option<String> {
    match value {
        Literal::Text(_) | Literal::Int(_) | Literal::Float(_) => Some(value.to_string()),
        Literal::Bool(_) | Literal::List(_) | Literal::Section(_) => None,
    }
}

struct Read<'a> {
    args: &'a Args,
    faults: Vec<Fault>,
}

impl<'a> Read<'a> {
    fn new(decl: &'a SourceDecl, known: &[&str], what: &str) -> Self {
        let mut all = vec!["path"];
        all.extend(known);
        let unknown = |k: &&String| !known.contains(&k.split('.').next().unwrap_or(k));
        let faults = decl.options.iter().filter(|(k, _)| unknown(k)).map(|(k, given)| {
            let option = k.split('.').next().unwrap_or(k);
            Fault::new(format!("{what} has no option `{option}`")).nearest(option, &all).at(given.key_at.clone())
        });
        Self { args: &decl.options, faults: faults.collect() }
    }

    fn wrong(&mut self, key: &str, what: String) {
        let fault = Fault::new(what);
        self.faults.push(match self.args.get(key) {
            Some(given) => fault.at(given.at.clone()),
            None => fault,
        });
    }

    fn get<T: Value>(&mut self, key: &str) -> Option<T> {
        let given = self.args.get(key)?;
        let value = T::read(&given.value);
        if value.is_none() {
            self.wrong(key, format!("`{key}` must be a {}, not a {}", T::TYPE, given.value.type_name()));
        }
        value
    }

    fn epsg(&mut self) -> Option<u16> {
        let code: usize = self.get("epsg")?;
        let fits = u16::try_from(code).ok();
        if fits.is_none() {
            self.wrong("epsg", format!("there is no EPSG code {code}"));
        }
        fits
    }

    /// An option that is a table of texts, such as `rename`. Its keys are names of the file, with all their dots.
    fn table(&mut self, option: &str) -> BTreeMap<String, String> {
        if self.args.contains_key(option) {
            self.wrong(option, format!("`{option}` must be a table: `{option} = {{ \"theirs\" = \"...\" }}`"));
        }
        let prefix = format!("{option}.");
        let named: Vec<String> = self.args.keys().filter(|k| k.starts_with(&prefix)).cloned().collect();
        let one = |key: String| self.get::<String>(&key).map(|to| (key[prefix.len()..].to_owned(), to));
        named.into_iter().filter_map(one).collect()
    }

    fn accepted(&mut self) -> Vec<Accept> {
        let words: Vec<String> = self.get("accept").unwrap_or_default();
        let mut found = vec![];
        for word in words {
            match (Accept::parse(&word), self.args.get("accept")) {
                (Ok(accept), _) => found.push(accept),
                (Err(fault), Some(given)) => self.faults.push(fault.at(given.at.clone())),
                (Err(fault), None) => self.faults.push(fault),
            }
        }
        found
    }

    /// An option that is a list of words; numbers are taken as they are written.
    fn words(&mut self, option: &str) -> Vec<String> {
        let Some(given) = self.args.get(option) else { return vec![] };
        let words: Option<Vec<String>> = match &given.value {
            Literal::List(all) => all.iter().map(word).collect(),
            one => word(one).map(|w| vec![w]),
        };
        if words.is_none() {
            self.wrong(option, format!("`{option}` must be a list of texts, such as [\"N/A\", \"-99999\"]"));
        }
        words.unwrap_or_default()
    }

    fn finish<T>(self, options: T) -> Result<T, Vec<Fault>> {
        if self.faults.is_empty() { Ok(options) } else { Err(self.faults) }
    }
}
