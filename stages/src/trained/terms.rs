//! Layout of the table of a nonlinear model: each number has a name, its term.
//!
//! A term is `KEY`, `KEY[i]` or `KEY[i,j]`, counted from 1. A space and a word may follow, such as the name of an input
//! or an activation. Each key occurs once, so a table may be sorted in any way.

use std::collections::HashMap;

use schemas::{Fault, Literal, ParamValue};

/// A term and its value.
#[derive(Clone, Debug, PartialEq)]
pub struct TermValue {
    /// The term.
    pub name: String,
    /// Value.
    pub value: f64,
}

/// A term.
pub fn term(name: impl Into<String>, value: f64) -> TermValue {
    TermValue { name: name.into(), value }
}

/// The terms `KEY[1]`, `KEY[2]`... of some values.
pub fn list<'a>(key: &'a str, values: &'a [f64]) -> impl Iterator<Item = TermValue> + 'a {
    values.iter().enumerate().map(move |(i, value)| term(format!("{key}[{}]", i + 1), *value))
}

/// Same as [`list`], with a word for each term.
pub fn named_list<'a>(key: &'a str, words: &'a [String], values: &'a [f64]) -> impl Iterator<Item = TermValue> + 'a {
    let all = words.iter().zip(values).enumerate();
    all.map(move |(i, (word, value))| term(format!("{key}[{}] {word}", i + 1), *value))
}

/// Prefix of the terms of a member.
pub fn member_of(number: usize) -> String {
    if number == 0 { String::new() } else { format!("member{}.", number + 1) }
}

/// The terms of a table, by key.
pub struct TermLookup<'a> {
    found: HashMap<&'a str, (&'a str, f64)>,
}

impl<'a> TermLookup<'a> {
    /// Reads the terms of a table.
    ///
    /// # Errors
    /// Fails if a key is duplicate.
    pub fn new(names: &'a [String], values: &[f64]) -> Result<Self, Fault> {
        let mut found = HashMap::new();
        for (name, value) in names.iter().zip(values) {
            let (key, word) = name.split_once(' ').unwrap_or((name, ""));
            if found.insert(key, (word, *value)).is_some() {
                return Err(broken(format!("duplicate term `{key}`")));
            }
        }
        Ok(Self { found })
    }

    /// The value of a key.
    ///
    /// # Errors
    /// Fails if the key is missing, or its value is not finite.
    pub fn value(&self, key: &str) -> Result<f64, Fault> {
        let (_, value) = self.found.get(key).ok_or_else(|| missing(key))?;
        if value.is_finite() { Ok(*value) } else { Err(broken(format!("the term `{key}` is {value}"))) }
    }

    /// The word of a key.
    ///
    /// # Errors
    /// Fails if it is missing.
    pub fn word(&self, key: &str) -> Result<&'a str, Fault> {
        self.found.get(key).map(|(word, _)| *word).ok_or_else(|| missing(key))
    }

    /// The choice that the word of a key selects.
    ///
    /// # Errors
    /// Fails if the key is missing, or its word is not among the choices.
    pub fn choice<T: ParamValue>(&self, key: &str) -> Result<T, Fault> {
        let word = self.word(key)?;
        let read = T::read(&Literal::Text(word.to_owned()));
        read.ok_or_else(|| broken(format!("`{key}` is `{word}`, but must be one of `{}`", T::WORDS.join("`, `"))))
    }

    /// The value of a key that holds a whole number.
    ///
    /// # Errors
    /// Fails if the key is missing, or its value is not a whole number.
    pub fn count(&self, key: &str) -> Result<usize, Fault> {
        let value = self.value(key)?;
        let whole = value.fract() == 0.0 && (0.0..=1e7).contains(&value);
        if whole {
            Ok(value as usize)
        } else {
            Err(broken(format!("the term `{key}` is {value}, but must be a count")))
        }
    }

    /// The values of `KEY[1]`, `KEY[2]`... with their words.
    ///
    /// # Errors
    /// Fails if an index between the first and the last is missing.
    pub fn list(&self, key: &str) -> Result<(Vec<String>, Vec<f64>), Fault> {
        let of = |name: &&&str| name.strip_prefix(key).is_some_and(|rest| rest.starts_with('[') && !rest.contains(','));
        let count = self.found.keys().filter(of).count();
        let all = (1..=count).map(|i| {
            let key = format!("{key}[{i}]");
            Ok((self.word(&key)?.to_owned(), self.value(&key)?))
        });
        Ok(all.collect::<Result<Vec<_>, Fault>>()?.into_iter().unzip())
    }
}

fn missing(key: &str) -> Fault {
    broken(format!("the term `{key}` is missing"))
}

/// Fault of an incomplete table.
pub fn broken(what: String) -> Fault {
    Fault::data(format!("the model cannot be used: {what}")).help("fit the model again")
}
