//! Values that are lists: vectors, matrices, rows and names.

use std::ops::Range;

use schemas::Fault;
use toml::{Spanned, de::DeValue};

use super::{Section, number};

/// The value of an entry whose key is a name.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super::super) enum Amount {
    /// One number.
    Size(f64),
    /// Three numbers.
    Exact([f64; 3]),
}

fn row<const N: usize>(value: &DeValue) -> Option<[f64; N]> {
    let found: Option<Vec<f64>> =
        value.as_array()?.iter().map(|v| number(v.get_ref()).filter(|x| x.is_finite())).collect();
    found.and_then(|list| <[f64; N]>::try_from(list).ok())
}

impl Section<'_> {
    /// Three numbers that may be left out.
    pub(in super::super::super) fn vector(&self, key: &'static str) -> Option<[f64; 3]> {
        let value = self.get(key)?;
        let found = row(value.get_ref());
        if found.is_none() {
            self.wrong(key, value, "a list of three numbers");
        }
        found
    }

    /// Rows of N numbers each; none where it is left out.
    pub(in super::super::super) fn rows<const N: usize>(&self, key: &'static str) -> Option<Vec<[f64; N]>> {
        let value = self.get(key)?;
        let list = value.get_ref().as_array();
        let found: Option<Vec<_>> = list.and_then(|list| list.iter().map(|v| row(v.get_ref())).collect());
        if found.is_none() {
            self.wrong(key, value, &format!("a list of lists of {N} numbers"));
        }
        found
    }

    /// A matrix of three rows of three numbers that may be left out.
    pub(in super::super::super) fn matrix(&self, key: &'static str) -> Option<[[f64; 3]; 3]> {
        let found = <[[f64; 3]; 3]>::try_from(self.rows(key)?).ok();
        if found.is_none() {
            self.fault_at(key, format!("`{key}` of `{}` must have three rows of three numbers", self.name));
        }
        found
    }

    /// All keys, which are names, with a number or three.
    pub(in super::super::super) fn amounts(&self) -> Vec<(String, Amount, Range<usize>)> {
        let mut out = vec![];
        for (key, value) in self.table {
            let size = number(value.get_ref()).filter(|x| x.is_finite()).map(Amount::Size);
            match size.or_else(|| row(value.get_ref()).map(Amount::Exact)) {
                Some(amount) => out.push((key.get_ref().to_string(), amount, key.span())),
                None => self.wrong(key.get_ref(), value, "a number or a list of three"),
            }
        }
        out
    }

    /// Notes a fault at the value of `key`.
    pub(in super::super::super) fn push_at(&self, key: &'static str, fault: Fault) {
        let at = self.get(key).map_or(self.span.clone(), Spanned::span);
        self.push(fault.at(at));
    }
}
