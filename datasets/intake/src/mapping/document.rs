//! The text of a mapping: its tables, with the positions of all keys and values.

use std::ops::Range;

use schemas::{ChoiceRegistry, Fault, Literal, ParamReader, Params, SpecEntries, SpecEntry, SpecSection};

use super::declare::{
    AttitudeKeys, LogEpochKeys, MappingColumnKeys, MappingTableKeys, ProjectedPositionKeys, QuaternionKeys,
    RowIdentifierKeys, TableClockKeys, TimeStampKeys, VectorSensorKeys,
};

/// Byte range in the text of a mapping.
pub type MappingSpan = Range<usize>;

/// Value parsed from a table, with the keys as given and the position in the text.
#[derive(Clone, Debug)]
pub struct SpannedValue<T> {
    /// Value.
    pub value: T,
    /// Keys as given.
    pub args: SpecEntries,
    /// Position.
    pub at: MappingSpan,
}

impl<T> SpannedValue<T> {
    /// Position of the value of a key, or of the whole table if the key is unset.
    pub fn at(&self, key: &str) -> MappingSpan {
        self.args.get(key).map_or(self.at.clone(), |given| given.at.clone())
    }
}

/// Source of the flight or line identifier of a row.
#[derive(Clone, Debug)]
pub enum KeyDecl {
    /// One text for all rows.
    Constant(String),
    /// One identifier per row.
    Of(SpannedValue<RowIdentifierKeys>),
}

/// One table of a mapping.
#[derive(Clone, Debug)]
pub struct TableDecl {
    /// Name.
    pub name: String,
    /// Input that the table reads.
    pub head: SpannedValue<MappingTableKeys>,
    /// The flight, if set.
    pub flight: Option<KeyDecl>,
    /// The line, if set.
    pub line: Option<KeyDecl>,
    /// The time of each row.
    pub time: SpannedValue<TimeStampKeys>,
    /// Time at which the log's own clock was 0.
    pub epoch: Option<SpannedValue<LogEpochKeys>>,
    /// The columns by their names in the flight table, in the order of the text.
    pub columns: Vec<(String, SpannedValue<MappingColumnKeys>)>,
    /// The vector sensors by their names.
    pub vectors: Vec<(String, SpannedValue<VectorSensorKeys>)>,
    /// The attitudes that are quaternions.
    pub quaternions: Vec<SpannedValue<QuaternionKeys>>,
    /// The position in eastings and northings, if set.
    pub projected: Option<SpannedValue<ProjectedPositionKeys>>,
}

/// Parsed text of a mapping.
#[derive(Clone, Debug)]
pub struct MappingDocument {
    /// Purpose of the mapping.
    pub about: String,
    /// Tables, in the order of the text.
    pub tables: Vec<TableDecl>,
}

const TOP: [&str; 6] = ["about", "format", "flight", "line", "epoch", "tables"];
const TABLE: [&str; 7] = ["flight", "line", "time", "epoch", "columns", "vectors", "projected"];

/// Reads the text of a mapping.
///
/// # Errors
/// Fails with all faults of the mapping's form, each with its position.
pub fn read(text: &str) -> Result<MappingDocument, Vec<Fault>> {
    let root = SpecSection::document(text)?;
    let mut reading = MappingParser { faults: vec![], lists: ChoiceRegistry::default() };
    let document = reading.document(&root);
    if reading.faults.is_empty() { Ok(document) } else { Err(reading.faults) }
}

struct MappingParser {
    faults: Vec<Fault>,
    lists: ChoiceRegistry,
}

impl MappingParser {
    fn document(&mut self, root: &SpecSection) -> MappingDocument {
        for (key, given) in root.keys.iter().filter(|(key, _)| !TOP.contains(&key.as_str())) {
            let fault = Fault::new(format!("a mapping has no key `{key}`")).nearest(key, &TOP);
            self.faults.push(fault.at(given.key_at.clone()));
        }
        let about = self.text(&root.keys, "about").unwrap_or_default();
        let format = self.text(&root.keys, "format");
        let mut tables = vec![];
        match root.keys.get("tables") {
            None => self.faults.push(Fault::new("a mapping requires a table").help("add `[tables.NAME]`")),
            Some(given) => {
                for (name, given) in self.entries("tables", given) {
                    tables.extend(self.table(&name, &given, root, format.as_deref()));
                }
            }
        }
        MappingDocument { about, tables }
    }

    /// The entries of a table, in the order of the text.
    fn entries(&mut self, name: &str, given: &SpecEntry) -> Vec<(String, SpecEntry)> {
        let Literal::Section(section) = &given.value else {
            let what = format!("`{name}` must be a table, not a {}", given.value.type_name());
            self.faults.push(Fault::new(what).at(given.at.clone()));
            return vec![];
        };
        let mut all: Vec<(String, SpecEntry)> = section.keys.iter().map(|(k, g)| (k.clone(), g.clone())).collect();
        all.sort_by_key(|(_, given)| given.key_at.start);
        all
    }

    fn text(&mut self, args: &SpecEntries, key: &str) -> Option<String> {
        let given = args.get(key)?;
        if given.value.as_text().is_none() {
            self.faults.push(Fault::new(format!("`{key}` must be text")).at(given.at.clone()));
        }
        given.value.as_text().map(str::to_owned)
    }

    fn table(&mut self, name: &str, given: &SpecEntry, root: &SpecSection, format: Option<&str>) -> Option<TableDecl> {
        let fine = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
        if !(name.starts_with(|c: char| c.is_ascii_alphabetic()) && name.chars().all(fine)) {
            let fault = Fault::new(format!("`{}` is not a valid name of a table", name.escape_default()));
            let help = "a name begins with a letter and contains only letters, digits, `_` and `-`";
            self.faults.push(fault.help(help).at(given.key_at.clone()));
            return None;
        }
        let Literal::Section(section) = &given.value else {
            let what = format!("`tables.{name}` must be a table, not a {}", given.value.type_name());
            self.faults.push(Fault::new(what).at(given.at.clone()));
            return None;
        };
        // Faults of the whole table are shown at its header, because only an inline table has a known byte range.
        let at = given.key_at.clone();
        let of_mapping = |key: &str| section.keys.get(key).or(root.keys.get(key)).cloned();
        let lists = self.lists.clone();
        let mut reader = ParamReader::new(name, &section.keys, Some(at.clone()), &lists);
        let head = MappingTableKeys::read(&mut reader, None);
        let attitudes = AttitudeKeys::read(&mut reader, None);
        let time = TableClockKeys::read(&mut reader, None);
        let names = |docs: Vec<schemas::ParamDoc>| docs.into_iter().map(|d| d.name).collect::<Vec<_>>();
        let known = [names(MappingTableKeys::docs(&lists)), names(AttitudeKeys::docs(&lists)), TABLE.to_vec()].concat();
        reader.unknown_keys(&known, &[]);
        self.faults.extend(reader.into_faults());
        let flight = of_mapping("flight").and_then(|g| self.key("flight", &g));
        let line = of_mapping("line").and_then(|g| self.key("line", &g));
        // Faults of an `epoch` in a table are reported with the clock of the table.
        let epoch = match (section.keys.get("epoch"), root.keys.get("epoch")) {
            (None, Some(given)) => self.group::<LogEpochKeys>("epoch", given),
            (Some(given), _) => time.as_ref().and_then(|t| placed(t.epoch.clone()?.0, given)),
            (None, None) => None,
        };
        let columns = self.groups::<MappingColumnKeys>("columns", &section.keys);
        let vectors = self.groups::<VectorSensorKeys>("vectors", &section.keys);
        let position = section.keys.get("projected");
        let projected = position.and_then(|given| self.group::<ProjectedPositionKeys>("projected", given));
        let mut head = head?;
        head.format = head.format.or(format.map(str::to_owned));
        Some(TableDecl {
            name: name.to_owned(),
            head: SpannedValue { value: head, args: section.keys.clone(), at },
            flight,
            line,
            time: placed(time?.time.0, section.keys.get("time")?)?,
            epoch,
            columns,
            vectors,
            quaternions: quaternions(attitudes?, &section.keys),
            projected,
        })
    }

    /// A flight or a line: a string, a whole number, or a table.
    fn key(&mut self, name: &str, given: &SpecEntry) -> Option<KeyDecl> {
        match &given.value {
            Literal::Section(_) => self.group::<RowIdentifierKeys>(name, given).map(KeyDecl::Of),
            Literal::Text(_) | Literal::Int(_) => Some(KeyDecl::Constant(given.value.to_string())),
            // A number with a fraction would lose trailing zeros.
            Literal::Bool(_) | Literal::List(_) | Literal::Float(_) => {
                let what = format!("`{name}` must be text or a table, not a {}", given.value.type_name());
                self.faults.push(Fault::new(what).at(given.at.clone()));
                None
            }
        }
    }

    fn groups<T: Params>(&mut self, name: &str, args: &SpecEntries) -> Vec<(String, SpannedValue<T>)> {
        let Some(given) = args.get(name) else { return vec![] };
        let entries = self.entries(name, given);
        entries.iter().filter_map(|(key, given)| Some((key.clone(), self.group::<T>(key, given)?))).collect()
    }

    fn group<T: Params>(&mut self, name: &str, given: &SpecEntry) -> Option<SpannedValue<T>> {
        let Literal::Section(section) = &given.value else {
            let what = format!("`{name}` must be a table, not a {}", given.value.type_name());
            self.faults.push(Fault::new(what).at(given.at.clone()));
            return None;
        };
        let lists = self.lists.clone();
        let (group, faults) =
            ParamReader::new(name, &section.keys, Some(given.key_at.clone()), &lists).group::<T>(None);
        let fine = faults.is_empty();
        self.faults.extend(faults);
        placed(group.filter(|_| fine)?, given)
    }
}

fn placed<T>(value: T, given: &SpecEntry) -> Option<SpannedValue<T>> {
    let Literal::Section(section) = &given.value else { return None };
    Some(SpannedValue { value, args: section.keys.clone(), at: given.key_at.clone() })
}

fn quaternions(attitudes: AttitudeKeys, args: &SpecEntries) -> Vec<SpannedValue<QuaternionKeys>> {
    let given = args.get("quaternions");
    let at = given.map_or(0..0, |g| g.key_at.clone());
    let sections: Vec<SpecEntries> = match given.map(|g| &g.value) {
        Some(Literal::List(items)) => items.iter().filter_map(section_of).collect(),
        Some(one) => section_of(one).into_iter().collect(),
        None => vec![],
    };
    let each = attitudes.quaternions.0.into_iter().zip(sections);
    each.map(|(value, args)| SpannedValue { value, args, at: at.clone() }).collect()
}

fn section_of(literal: &Literal) -> Option<SpecEntries> {
    if let Literal::Section(section) = literal { Some(section.keys.clone()) } else { None }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn gold_all_faults_are_reported_with_their_positions() {
        let text = "aboot = 'x'\n[tables.mag]\ntopik = 'MAG'\ntime = { from = 'TimeUS', clock = 'bot' }\n\
                    [tables.mag.columns]\nlat = { from = 'Lat', unti = 'deg' }\nlon = 3\n[tables.mag.vectors]\n\
                    flux_a = { from = ['a', 'b', 'c'], scale = 'x' }\n";
        let faults = read(text).unwrap_err();
        let found: Vec<(String, &str)> =
            faults.iter().map(|f| (f.to_string(), f.at.clone().map_or("", |at| &text[at]))).collect();
        let expected = [
            ("a mapping has no key `aboot` (did you mean `about`?)", "aboot"),
            ("`clock` cannot be `bot` (did you mean `boot`?)", "'bot'"),
            ("`mag` has no parameter `topik` (did you mean `topic`?)", "topik"),
            ("`lat` has no parameter `unti` (did you mean `unit`?)", "unti"),
            ("`lon` must be a table, not a whole number", "3"),
            ("`scale` of `flux_a` must be a list of numbers, not a text", "'x'"),
        ];
        assert_eq!(found.iter().map(|(a, b)| (a.as_str(), *b)).collect::<Vec<_>>(), expected);
    }

    #[test]
    fn unit_top_level_keys_apply_to_all_tables() {
        let text = "flight = 171\nline = { of_file = true }\nepoch = { utc = '2012-10-10' }\n\
                    [tables.a]\ntime = { from = 't', clock = 'boot' }\n\
                    [tables.b]\nline = '2'\nepoch = { unknown = true }\ntime = { from = ['d', 't'], clock = 'boot' }\n";
        let document = read(text).unwrap();
        let [a, b] = document.tables.as_slice() else { panic!() };
        assert!(matches!(&a.flight, Some(KeyDecl::Constant(x)) if x == "171"));
        assert!(matches!(&a.line, Some(KeyDecl::Of(k)) if k.value.of_file));
        assert!(matches!(&b.line, Some(KeyDecl::Constant(x)) if x == "2"));
        assert_eq!(a.epoch.as_ref().unwrap().value.utc.as_deref(), Some("2012-10-10"));
        assert!(b.epoch.as_ref().unwrap().value.unknown && b.time.value.from == ["d", "t"]);
        assert!(read("about = 'x'").is_err());
    }
}
