//! Keys and values of a TOML document, with their positions.

use std::{collections::BTreeMap, ops::Range};

use toml::{
    Spanned,
    de::{DeTable, DeValue},
};

use crate::{Fault, Literal};

/// Value of one key of the spec, with the positions of key and value.
#[derive(Clone, Debug, PartialEq)]
pub struct SpecEntry {
    /// Value.
    pub value: Literal,
    /// Byte range of the key.
    pub key_at: Range<usize>,
    /// Byte range of the value.
    pub at: Range<usize>,
}

/// Keys of a table of the spec, with their values.
pub type SpecEntries = BTreeMap<String, SpecEntry>;

/// A table of a spec.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SpecSection {
    /// Keys.
    pub keys: SpecEntries,
    /// Byte range of the table.
    pub at: Range<usize>,
}

impl SpecSection {
    /// Parses a whole document.
    ///
    /// # Errors
    /// Fails for invalid TOML, or for values that a spec does not permit. Each fault has its position.
    pub fn document(text: &str) -> Result<SpecSection, Vec<Fault>> {
        let root = DeTable::parse(text).map_err(|e| {
            let fault = Fault::new(e.message());
            vec![e.span().into_iter().fold(fault, Fault::at)]
        })?;
        SpecSection::from_table(root.get_ref(), root.span())
    }

    /// Converts a parsed table.
    ///
    /// # Errors
    /// Fails for values that a spec does not permit, with the position of each.
    pub fn from_table(table: &DeTable, at: Range<usize>) -> Result<SpecSection, Vec<Fault>> {
        let (mut keys, mut faults) = (SpecEntries::new(), vec![]);
        for (key, value) in table {
            match literal(value) {
                Ok(read) => {
                    let given = SpecEntry { value: read, key_at: key.span(), at: value.span() };
                    keys.insert(key.get_ref().to_string(), given);
                }
                Err(more) => faults.extend(more),
            }
        }
        if faults.is_empty() { Ok(SpecSection { keys, at }) } else { Err(faults) }
    }
}

/// Converts a parsed value.
///
/// # Errors
/// Fails for values that a spec does not permit: dates, NaN, or integers beyond 64 bits.
pub fn literal(value: &Spanned<DeValue>) -> Result<Literal, Vec<Fault>> {
    let wrong = |what: String| vec![Fault::new(what).at(value.span())];
    match value.get_ref() {
        DeValue::String(s) => Ok(Literal::Text(s.to_string())),
        DeValue::Boolean(b) => Ok(Literal::Bool(*b)),
        DeValue::Integer(n) => i64::from_str_radix(n.as_str(), n.radix())
            .map(Literal::Int)
            .map_err(|_| wrong(format!("{} is outside the range of 64-bit integers", n.as_str()))),
        DeValue::Float(x) => match x.as_str().parse::<f64>() {
            Ok(x) if !x.is_nan() => Ok(Literal::Float(x)),
            _ => Err(wrong(format!("{} is not allowed here", x.as_str()))),
        },
        DeValue::Array(items) => {
            let mut faults = vec![];
            let read = items.iter().filter_map(|v| literal(v).map_err(|more| faults.extend(more)).ok()).collect();
            if faults.is_empty() { Ok(Literal::List(read)) } else { Err(faults) }
        }
        DeValue::Datetime(_) => Err(wrong("a date value is not allowed here; write it as text".to_owned())),
        DeValue::Table(table) => SpecSection::from_table(table, value.span()).map(Literal::Section),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_every_value_keeps_its_position() {
        let text = "a = 1\n[ins]\ngrade = \"tactical\"\n[[flights]]\nname = \"1\"\n";
        let root = SpecSection::document(text).unwrap();
        let Literal::Section(ins) = &root.keys["ins"].value else { panic!("{root:?}") };
        assert_eq!(&text[ins.keys["grade"].at.clone()], "\"tactical\"");
        let Literal::List(flights) = &root.keys["flights"].value else { panic!("{root:?}") };
        assert!(matches!(&flights[0], Literal::Section(s) if s.keys.contains_key("name")));
    }

    #[test]
    fn unit_all_invalid_values_are_reported() {
        let faults = SpecSection::document("a = nan\nb = [1, 99999999999999999999]\nc = 2020-01-01\n").unwrap_err();
        assert_eq!(faults.len(), 3, "{faults:?}");
        assert!(faults.iter().all(|f| f.at.is_some()));
    }
}
