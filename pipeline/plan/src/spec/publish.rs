//! Parts of a spec that concern publication: the facts of a published data set (`[publish]`), and the tables and
//! columns that must stay in the organisation (`restricted`, `embargo`).

use std::ops::Range;

use schemas::{
    ChoiceRegistry, Fault, Literal, ParamReader, ParamValue, ParamsList, Rule, SpecEntries, SpecSection, params,
};
use store::clock;

params! {
    /// An author: a person with `given` and `family`, or an organisation with `name`.
    pub struct Author;
    /// The name of an organisation, or of a person with a single name.
    name: Option<String>, unit "", default None, absent "`given` and `family`";
    /// The given names of a person.
    given: Option<String>, unit "", default None, absent "`name`";
    /// The family name of a person.
    family: Option<String>, unit "", default None, absent "`name`";
    /// The person's ORCID, such as `0000-0002-1825-0097`.
    orcid: Option<String>, unit "", default None, absent "none";
    /// The institution of the author.
    affiliation: Option<String>, unit "", default None, absent "none";
}

impl Author {
    /// The name in full.
    pub fn full_name(&self) -> String {
        match (&self.name, &self.given, &self.family) {
            (Some(name), _, _) => name.clone(),
            (None, given, family) => given.iter().chain(family).cloned().collect::<Vec<_>>().join(" "),
        }
    }
}

params! {
    /// The metadata of a published set: the table `[publish]` of a spec.
    pub struct PublishFacts;
    /// The title of the data set.
    title: String, unit "";
    /// The content and purpose of the data set, in a few sentences.
    description: String, unit "";
    /// The authors, in the order of the citation: `[[publish.authors]]` with `given` and `family`, or `name`.
    authors: ParamsList<Author>, unit "";
    /// The licence as an SPDX identifier, such as `CC-BY-4.0`, or another name with `licence_url`.
    licence: String, unit "";
    /// The address of the licence's text.
    licence_url: Option<String>, unit "", default None, absent "the address of the SPDX identifier";
    /// The file with the text of the licence, in the spec's folder. Its text becomes the file `LICENSE`.
    licence_file: Option<String>, unit "", default None, absent "`LICENSE` contains the name and URL of the licence";
    /// The date of publication, `YYYY-MM-DD`.
    date: String, unit "";
    /// An address for questions: e-mail or web.
    contact: String, unit "";
    /// The version of the data set, `MAJOR.MINOR.PATCH`.
    version: String, unit "", default "1.0.0";
    /// The DOI, such as `10.5281/zenodo.1234567`.
    doi: Option<String>, unit "", default None, absent "none";
    /// The address of the data set's page.
    url: Option<String>, unit "", default None, absent "the address of the DOI";
    /// Keywords.
    keywords: Vec<String>, unit "", default Vec::<String>::new();
    /// Whether to copy the input files into the published set, so that it can be recomputed from its own files. Their
    /// licences must permit that.
    include_inputs: bool, unit "", default false;
    /// For the datasheet: the purpose of the data.
    motivation: Option<String>, unit "", default None, absent "not provided";
    /// For the datasheet: the method, place and equipment of the recording.
    collection: Option<String>, unit "", default None, absent "not provided";
    /// For the datasheet: suitable and unsuitable uses.
    uses: Option<String>, unit "", default None, absent "not provided";
    /// For the datasheet: known faults and limits.
    limits: Option<String>, unit "", default None, absent "not provided";
}

/// Template of the table `[publish]`, for a spec without it.
pub const EXAMPLE: &str = "write\n\
    [publish]\n\
    title       = \"...\"\n\
    description = \"...\"\n\
    licence     = \"CC-BY-4.0\"\n\
    date        = \"2026-01-31\"\n\
    contact     = \"name@example.org\"\n\
    [[publish.authors]]\n\
    given  = \"...\"\n\
    family = \"...\"";

/// The facts of `[publish]`.
///
/// # Errors
/// Fails with all faults, each with its position.
pub fn read_facts(section: &SpecSection) -> Result<PublishFacts, Vec<Fault>> {
    let lists = ChoiceRegistry::default();
    let reader = ParamReader::new("publish", &section.keys, Some(section.at.clone()), &lists);
    let (facts, mut faults) = reader.group::<PublishFacts>(None);
    let at = |key: &str| section.keys.get(key).map_or(section.at.clone(), |given| given.at.clone());
    if let Some(facts) = &facts {
        faults.extend(wrong(facts).into_iter().map(|(key, fault)| fault.at(at(key))));
    }
    facts.filter(|_| faults.is_empty()).ok_or(faults)
}

/// Faults that the types cannot detect, each as its key and its message.
fn wrong(facts: &PublishFacts) -> Vec<(&'static str, Fault)> {
    let mut found = vec![];
    let mut blank = |key: &'static str, text: &str| {
        if text.trim().is_empty() {
            found.push((key, Fault::new(format!("`{key}` is empty"))));
        }
    };
    for (key, text) in [
        ("title", &facts.title),
        ("description", &facts.description),
        ("licence", &facts.licence),
        ("contact", &facts.contact),
        ("version", &facts.version),
    ] {
        blank(key, text);
    }
    let mut push = |key: &'static str, what: String, help: &str| found.push((key, Fault::new(what).help(help)));
    if !is_date(&facts.date) {
        push("date", format!("`{}` is not a date", facts.date), "write it as `2026-01-31`");
    }
    let parts: Vec<&str> = facts.version.split('.').collect();
    if parts.len() != 3 || !parts.iter().all(|p| !p.is_empty() && p.bytes().all(|b| b.is_ascii_digit())) {
        push("version", format!("`{}` is not a version", facts.version), "write it as `1.0.0`");
    }
    if facts.authors.0.is_empty() {
        push("authors", "there are no authors".to_owned(), "add `[[publish.authors]]` with `given` and `family`");
    }
    for author in &facts.authors.0 {
        let whole = author.name.is_some() && author.given.is_none() && author.family.is_none();
        let parts = author.name.is_none() && author.given.is_some() && author.family.is_some();
        if !whole && !parts {
            let what = "an author requires either `name`, or both `given` and `family`".to_owned();
            push(
                "authors",
                what,
                "write a person as `given = \"Ada\"`, `family = \"Lovelace\"`, and an organisation as `name = \
                 \"...\"`",
            );
        }
        if let Some(orcid) = author.orcid.as_ref().filter(|o| !is_orcid(o)) {
            push(
                "authors",
                format!("`{orcid}` is not an ORCID"),
                "check for a typing error: the last character is a \
                checksum of the others",
            );
        }
    }
    if let Some(doi) = facts.doi.as_ref().filter(|d| !is_doi(d)) {
        push(
            "doi",
            format!("`{doi}` is not a DOI"),
            "write it as `10.5281/zenodo.1234567`, without a web address before it",
        );
    }
    for (key, url) in [("url", &facts.url), ("licence_url", &facts.licence_url)] {
        if let Some(url) = url.as_ref().filter(|u| url::Url::parse(u).is_err()) {
            push(key, format!("`{url}` is not a web address"), "write it as `https://...`");
        }
    }
    found
}

/// Whether a string is a day of the (proleptic Gregorian) calendar, `YYYY-MM-DD`.
pub fn is_date(text: &str) -> bool {
    let parts: Vec<&str> = text.split('-').collect();
    let [year, month, day] = parts.as_slice() else { return false };
    let digits = |word: &str, n: usize| word.len() == n && word.bytes().all(|b| b.is_ascii_digit());
    if !digits(year, 4) || !digits(month, 2) || !digits(day, 2) {
        return false;
    }
    let (Ok(year), Ok(month), Ok(day)) = (year.parse::<u32>(), month.parse::<usize>(), day.parse::<u32>()) else {
        return false;
    };
    let leap = (year.is_multiple_of(4) && !year.is_multiple_of(100)) || year.is_multiple_of(400);
    let lengths = [31, 28 + u32::from(leap), 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];
    month.checked_sub(1).and_then(|m| lengths.get(m)).is_some_and(|length| (1..=*length).contains(&day))
}

/// Whether a string is an ORCID, with or without its address: 15 digits and a check digit. [ISO 7064, MOD 11-2]
fn is_orcid(text: &str) -> bool {
    let bare = text.strip_prefix("https://orcid.org/").unwrap_or(text);
    let groups: Vec<&str> = bare.split('-').collect();
    let digits: String = groups.concat();
    if groups.len() != 4 || groups.iter().any(|g| g.len() != 4) || !digits.is_ascii() {
        return false;
    }
    let (body, check) = digits.split_at(15);
    let Some(body) = body.chars().map(|c| c.to_digit(10)).collect::<Option<Vec<u32>>>() else { return false };
    let total = body.iter().fold(0, |sum, d| (sum + d) * 2);
    let wanted = match (12 - total % 11) % 11 {
        10 => "X".to_owned(),
        d => d.to_string(),
    };
    check == wanted
}

fn is_doi(text: &str) -> bool {
    let Some((prefix, suffix)) = text.strip_prefix("10.").and_then(|rest| rest.split_once('/')) else { return false };
    let fine = |c: char| !c.is_whitespace() && !c.is_control();
    prefix.len() >= 4
        && prefix.chars().all(|c| c.is_ascii_digit() || c == '.')
        && !suffix.is_empty()
        && suffix.chars().all(fine)
}

/// Restricted columns of a table.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum ColumnRestriction {
    /// No columns.
    #[default]
    None,
    /// All columns.
    All,
    /// These columns.
    Columns(Vec<String>),
}

impl ParamValue for ColumnRestriction {
    const TYPE: &'static str = "boolean or list of columns";

    fn read(literal: &Literal) -> Option<ColumnRestriction> {
        match literal {
            Literal::Bool(true) => Some(ColumnRestriction::All),
            Literal::Bool(false) => Some(ColumnRestriction::None),
            Literal::List(items) => {
                let names: Option<Vec<String>> = items.iter().map(|i| i.as_text().map(str::to_owned)).collect();
                names.map(ColumnRestriction::Columns)
            }
            Literal::Int(_) | Literal::Float(_) | Literal::Text(_) | Literal::Section(_) => None,
        }
    }

    fn check(&self, _: &Rule) -> Result<(), Fault> {
        Ok(())
    }

    fn canonical(&self) -> String {
        match self {
            ColumnRestriction::None => "false".to_owned(),
            ColumnRestriction::All => "true".to_owned(),
            ColumnRestriction::Columns(names) => format!("{names:?}"),
        }
    }
}

params! {
    /// Publication restrictions of a table of files: keys of `[tables.NAME]`, in addition to the keys of its format.
    pub struct ProtectionKeys, all default;
    /// `true` for the whole table, or the names of columns. `magline publish` rejects results made from them row by
    /// row.
    restricted: ColumnRestriction, unit "", default ColumnRestriction::None;
    /// The first day of permitted publication, `YYYY-MM-DD`. Without `restricted`, it applies to the whole table.
    embargo: Option<String>, unit "", default None, absent "the restriction does not end";
    /// The reason, for messages and for a published set with `--include-restricted`.
    reason: Option<String>, unit "", default None, absent "no reason";
    /// Minimum number of samples behind each published score or coefficient that is computed from restricted columns.
    least_samples: usize, unit "1", default 100usize, rule Rule::Between(2.0, 1e9);
    /// Minimum ratio of the number of samples of an aggregate to the number of values that it publishes, such as the
    /// scores of a line or the coefficients of a model.
    least_ratio: f64, unit "1", default 10.0, rule Rule::Between(1.0, 1e9);
}

/// The keys of [`ProtectionKeys`].
pub const PROTECTION_KEYS: [&str; 5] = ["restricted", "embargo", "reason", "least_samples", "least_ratio"];

impl ProtectionKeys {
    /// Reads the keys of the restrictions and removes them from the keys of a table. The table is at the bytes `at`.
    ///
    /// # Errors
    /// Fails with all faults, each with its position.
    pub fn take(table: &str, options: &mut SpecEntries, at: Range<usize>) -> Result<ProtectionKeys, Vec<Fault>> {
        let own: SpecEntries = PROTECTION_KEYS.iter().filter_map(|k| options.remove_entry(*k)).collect();
        let lists = ChoiceRegistry::default();
        let (read, mut faults) = ParamReader::new(table, &own, Some(at), &lists).group::<ProtectionKeys>(None);
        let read = read.unwrap_or_default();
        let place = |key: &str, fault: Fault| own.get(key).map_or(fault.clone(), |given| fault.at(given.at.clone()));
        if let Some(day) = read.embargo.as_ref().filter(|d| !is_date(d)) {
            let fault = Fault::new(format!("`{day}` is not a date")).help("write it as `2026-01-31`");
            faults.push(place("embargo", fault));
        }
        if own.contains_key("reason") && read.embargo.is_none() && read.restricted == ColumnRestriction::None {
            let fault = Fault::new(format!("`reason` of `{table}` has no effect, because nothing is restricted"));
            faults.push(place("reason", fault.help("add `restricted` or `embargo`, or remove this key")));
        }
        let lone = own.keys().find(|k| k.starts_with("least_"));
        if let Some(key) = lone.filter(|_| read.embargo.is_none() && read.restricted == ColumnRestriction::None) {
            let fault = Fault::new(format!("`{key}` of `{table}` has no effect, because nothing is restricted"));
            faults.push(place(key, fault.help("add `restricted` or `embargo`, or remove this key")));
        }
        if faults.is_empty() { Ok(read) } else { Err(faults) }
    }

    /// Current restrictions.
    pub fn now(&self) -> ColumnRestriction {
        self.on(clock::now().get(..10).unwrap_or_default())
    }

    /// Restrictions on the day `today`, in the form `YYYY-MM-DD`. Such days can be compared as strings.
    fn on(&self, today: &str) -> ColumnRestriction {
        match &self.embargo {
            Some(day) if today >= day.as_str() => ColumnRestriction::None,
            Some(_) if self.restricted == ColumnRestriction::None => ColumnRestriction::All,
            Some(_) | None => self.restricted.clone(),
        }
    }

    /// Faults of restricted columns that the table does not have: a misspelt name would protect nothing.
    pub fn unknown(&self, table: &str, known: &[&str]) -> Vec<Fault> {
        let ColumnRestriction::Columns(names) = &self.restricted else { return vec![] };
        let unknown = names.iter().filter(|n| !known.contains(&n.as_str()));
        unknown.map(|n| Fault::new(format!("`{table}` has no column `{n}` to restrict")).nearest(n, known)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FULL: &str = "title = \"t\"\ndescription = \"d\"\nlicence = \"CC0-1.0\"\ndate = \"2026-02-28\"\n\
        contact = \"a@b.c\"\nauthors = [{ given = \"A\", family = \"B\", orcid = \"0000-0002-1825-0097\" }]\n";

    fn facts(text: &str) -> Result<PublishFacts, Vec<String>> {
        let section = SpecSection::document(text).unwrap();
        read_facts(&section).map_err(|faults| faults.iter().map(|f| f.what.clone()).collect())
    }

    #[test]
    fn unit_facts_are_read_and_each_fault_is_reported() {
        assert_eq!(facts(FULL).unwrap().authors.0[0].full_name(), "A B");
        let slips = [
            ("2026-02-28", "2026-02-29", "`2026-02-29` is not a date"),
            ("0097", "0098", "`0000-0002-1825-0098` is not an ORCID"),
            ("family = \"B\", ", "", "an author requires either `name`, or both `given` and `family`"),
            ("licence", "license", "`publish` needs `licence`"),
            ("title = \"t\"\n", "", "`publish` needs `title`"),
            ("contact = \"a@b.c\"", "contact = \" \"", "`contact` is empty"),
        ];
        for (from, to, expected_text) in slips {
            let found = facts(&FULL.replace(from, to)).unwrap_err();
            assert!(found.iter().any(|f| f == expected_text), "{expected_text}: {found:?}");
        }
        for doi in ["https://doi.org/10.1/x", "10.5281/", "10.5281/a b"] {
            assert!(facts(&format!("{FULL}doi = \"{doi}\"\n")).is_err(), "{doi}");
        }
        assert!(facts(&format!("{FULL}doi = \"10.5281/zenodo.1\"\n")).is_ok());
    }

    #[test]
    fn ref_check_digits_of_orcid() {
        // The examples of ORCID's documentation, the second with the check digit 10.
        assert!(is_orcid("0000-0002-1825-0097") && is_orcid("https://orcid.org/0000-0002-1694-233X"));
        assert!(!is_orcid("0000-0002-1825-009X") && !is_orcid("0000000218250097") && !is_orcid("0000-0002-1825-009"));
    }

    #[test]
    fn unit_an_embargo_ends_and_a_restriction_does_not() {
        let of = |text: &str| {
            let mut options = SpecSection::document(text).unwrap().keys;
            let read = ProtectionKeys::take("flights", &mut options, 0..0);
            assert!(options.keys().all(|k| k == "format"), "{options:?}");
            read
        };
        let one = of("restricted = [\"mag_1_c\"]\nembargo = \"2027-01-01\"\nformat = \"csv\"").unwrap();
        assert_eq!(one.on("2026-12-31"), ColumnRestriction::Columns(vec!["mag_1_c".into()]));
        assert_eq!(one.on("2027-01-01"), ColumnRestriction::None);
        assert_eq!(of("embargo = \"2027-01-01\"").unwrap().on("2026-01-01"), ColumnRestriction::All);
        assert_eq!(of("restricted = true\nreason = \"agreement\"").unwrap().on("9999-12-31"), ColumnRestriction::All);
        assert_eq!(of("").unwrap().on("2026-01-01"), ColumnRestriction::None);
        for wrong in ["embargo = \"soon\"", "reason = \"x\"", "restricted = 1", "restricted = [1]"] {
            assert!(of(wrong).is_err(), "{wrong}");
        }
        let unknown = one.unknown("flights", &["mag_1_c", "tt"]);
        assert!(unknown.is_empty());
        let slip = of("restricted = [\"mag_1c\"]").unwrap().unknown("flights", &["mag_1_c"]);
        assert_eq!(slip[0].help.as_deref(), Some("did you mean `mag_1_c`?"));
    }
}
