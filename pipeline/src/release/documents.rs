//! Documents of a set: each is made from [`ReleaseSet`] alone, so that verification can make it again.

use std::collections::BTreeMap;

use schemas::Fault;
use serde::Serialize;

use super::{
    citation, croissant, datapackage, dictionary, inputs, licence, readme, ro_crate,
    set::ReleaseSet,
    words::{DICTIONARY, LICENCE, LOCK},
};

/// Every document of `set` by its path, except a licence's own text.
///
/// # Errors
/// Never fails for a set that can be serialised as JSON.
pub fn all(set: &ReleaseSet) -> Result<BTreeMap<String, String>, Fault> {
    debug_assert!(LOCK.starts_with(inputs::FOLDER));
    let mut found: BTreeMap<String, String> = [
        (DICTIONARY, pretty(&set.dictionary)?),
        (LOCK, pretty(&set.lock)?),
        ("DICTIONARY.md", dictionary::write(set)),
        ("README.md", readme::write(set)),
        ("CITATION.cff", citation::write(&set.dictionary.about)),
        ("croissant.json", pretty(&croissant::write(set))?),
        ("datapackage.json", pretty(&datapackage::write(set))?),
        ("ro-crate-metadata.json", pretty(&ro_crate::write(set))?),
    ]
    .map(|(path, text)| (path.to_owned(), text))
    .into();
    for table in &set.dictionary.tables {
        found.insert(datapackage::schema_path(&table.name), pretty(&datapackage::schema(table))?);
    }
    if !set.dictionary.about.licence.text {
        found.insert(LICENCE.to_owned(), licence::write(&set.dictionary.about));
    }
    Ok(found)
}

/// JSON with line breaks, including a line break at the end.
fn pretty(value: &impl Serialize) -> Result<String, Fault> {
    serde_json::to_string_pretty(value).map(|text| text + "\n").map_err(|e| Fault::machine(e.to_string()))
}
