//! Reads one table of a spec: every value with its type and rule, every unknown key found, all faults
//! kept so that they are told at once.

use std::{cell::RefCell, ops::Range, rc::Rc};

use schemas::Fault;
use toml::{
    Spanned,
    de::{DeTable, DeValue},
};

pub(in super::super) use lists::Amount;

mod lists;

/// The faults found so far.
pub(in super::super) type Faults = Rc<RefCell<Vec<Fault>>>;

/// What a number has to be.
#[derive(Clone, Copy)]
pub(in super::super) enum Need {
    Any,
    Positive,
    NotNegative,
    Between(f64, f64),
}

impl Need {
    fn holds(self, x: f64) -> bool {
        match self {
            Need::Any => x.is_finite(),
            Need::Positive => x.is_finite() && x > 0.0,
            Need::NotNegative => x.is_finite() && x >= 0.0,
            Need::Between(a, b) => (a..=b).contains(&x),
        }
    }

    fn words(self) -> String {
        match self {
            Need::Any => "a number".to_owned(),
            Need::Positive => "above 0".to_owned(),
            Need::NotNegative => "0 or above".to_owned(),
            Need::Between(a, b) => format!("{a} to {b}"),
        }
    }
}

/// One table of the spec.
pub(in super::super) struct Section<'a> {
    name: &'static str,
    table: &'a DeTable<'a>,
    span: Range<usize>,
    asked: RefCell<Vec<&'static str>>,
    faults: Faults,
}

impl<'a> Section<'a> {
    pub(in super::super) fn new(
        name: &'static str,
        table: &'a DeTable<'a>,
        span: Range<usize>,
        faults: &Faults,
    ) -> Self {
        Self { name, table, span, asked: RefCell::default(), faults: faults.clone() }
    }

    /// Notes a fault about the whole table.
    pub(in super::super) fn fault(&self, what: String) {
        self.faults.borrow_mut().push(Fault::new(what).at(self.span.clone()));
    }

    /// Notes a fault about the value of `key`.
    pub(in super::super) fn fault_at(&self, key: &'static str, what: String) {
        let at = self.get(key).map_or(self.span.clone(), Spanned::span);
        self.faults.borrow_mut().push(Fault::new(what).at(at));
    }

    fn get(&self, key: &'static str) -> Option<&'a Spanned<DeValue<'a>>> {
        self.asked.borrow_mut().push(key);
        self.table.iter().find(|(k, _)| k.get_ref() == key).map(|(_, v)| v)
    }

    fn wrong(&self, key: &str, value: &Spanned<DeValue>, need: &str) {
        let what = format!("`{key}` of `{}` must be {need}", self.name);
        self.faults.borrow_mut().push(Fault::new(what).at(value.span()));
    }

    fn missing(&self, key: &str) {
        self.fault(format!("`{}` needs `{key}`", self.name));
    }

    /// A number that may be left out.
    pub(in super::super) fn optional(&self, key: &'static str, need: Need) -> Option<f64> {
        let value = self.get(key)?;
        let number = number(value.get_ref()).filter(|x| need.holds(*x));
        if number.is_none() {
            self.wrong(key, value, &need.words());
        }
        number
    }

    /// A number with a default.
    pub(in super::super) fn number(&self, key: &'static str, default: f64, need: Need) -> f64 {
        self.optional(key, need).unwrap_or(default)
    }

    /// A number that must be there; NaN stands for one that is not, beside its fault.
    pub(in super::super) fn needed(&self, key: &'static str, need: Need) -> f64 {
        if self.get(key).is_none() {
            self.missing(key);
        }
        self.optional(key, need).unwrap_or(f64::NAN)
    }

    /// True or false, with a default.
    pub(in super::super) fn flag(&self, key: &'static str, default: bool) -> bool {
        let Some(value) = self.get(key) else { return default };
        value.get_ref().as_bool().unwrap_or_else(|| {
            self.wrong(key, value, "true or false");
            default
        })
    }

    /// A whole number with a range.
    pub(in super::super) fn whole(&self, key: &'static str, default: i64, least: i64, most: i64) -> i64 {
        let Some(value) = self.get(key) else { return default };
        let found = match value.get_ref() {
            DeValue::Integer(i) => i64::from_str_radix(i.as_str(), i.radix()).ok(),
            _ => None,
        };
        found.filter(|x| (least..=most).contains(x)).unwrap_or_else(|| {
            self.wrong(key, value, &format!("a whole number, {least} to {most}"));
            default
        })
    }

    /// A list of numbers of a given length, with a default.
    pub(in super::super) fn numbers<const N: usize>(
        &self,
        key: &'static str,
        default: [f64; N],
        need: Need,
    ) -> [f64; N] {
        let Some(value) = self.get(key) else { return default };
        let found: Option<Vec<f64>> = value
            .get_ref()
            .as_array()
            .and_then(|list| list.iter().map(|v| number(v.get_ref()).filter(|x| need.holds(*x))).collect());
        found.and_then(|list| <[f64; N]>::try_from(list).ok()).unwrap_or_else(|| {
            self.wrong(key, value, &format!("a list of {N} numbers, each {}", need.words()));
            default
        })
    }

    /// A list of numbers that may be left out.
    pub(in super::super) fn list(&self, key: &'static str, need: Need) -> Option<Vec<f64>> {
        let value = self.get(key)?;
        let one = |v: &Spanned<DeValue>| number(v.get_ref()).filter(|x| need.holds(*x));
        let found: Option<Vec<f64>> = value
            .get_ref()
            .as_array()
            .and_then(|list| list.iter().map(one).collect())
            .filter(|l: &Vec<_>| !l.is_empty());
        if found.is_none() {
            self.wrong(key, value, &format!("a list of numbers, each {}", need.words()));
        }
        found
    }

    /// How many faults the spec has so far.
    pub(in super::super) fn faults(&self) -> usize {
        self.faults.borrow().len()
    }

    /// Text that must be there.
    pub(in super::super) fn text(&self, key: &'static str) -> String {
        let Some(value) = self.get(key) else {
            self.missing(key);
            return String::new();
        };
        match value.get_ref() {
            DeValue::String(s) if !s.is_empty() => s.to_string(),
            _ => {
                self.wrong(key, value, "text");
                String::new()
            }
        }
    }

    /// Text that may be left out.
    pub(in super::super) fn optional_text(&self, key: &'static str) -> Option<String> {
        self.get(key).map(|_| self.text(key))
    }

    /// One of some words, by position; the first where it is left out.
    pub(in super::super) fn word(&self, key: &'static str, known: &[&str]) -> usize {
        let Some(value) = self.get(key) else { return 0 };
        let given = value.get_ref().as_str().unwrap_or_default();
        known.iter().position(|k| *k == given).unwrap_or_else(|| {
            let fault = Fault::new(format!("`{key}` of `{}` cannot be `{given}`", self.name));
            self.faults.borrow_mut().push(fault.at(value.span()).nearest(given, known));
            0
        })
    }

    /// Places as a list of pairs, latitude and longitude in degrees.
    pub(in super::super) fn places(&self, key: &'static str) -> Vec<(f64, f64)> {
        let Some(value) = self.get(key) else {
            self.missing(key);
            return vec![];
        };
        let pair = |v: &Spanned<DeValue>| {
            let list = v.get_ref().as_array().filter(|l| l.len() == 2)?;
            let mut numbers = list.iter().filter_map(|x| number(x.get_ref()));
            let place = (numbers.next()?, numbers.next()?);
            (place.0.abs() < 89.0 && place.1.abs() <= 360.0).then_some(place)
        };
        let found: Option<Vec<_>> = value.get_ref().as_array().and_then(|list| list.iter().map(pair).collect());
        found.filter(|list| list.len() > 1).unwrap_or_else(|| {
            self.wrong(key, value, "a list of two or more [latitude, longitude] in degrees");
            vec![]
        })
    }

    /// A table inside this one.
    pub(in super::super) fn section(&self, name: &'static str) -> Option<Section<'a>> {
        let value = self.get(name)?;
        match value.get_ref() {
            DeValue::Table(table) => Some(Section::new(name, table, value.span(), &self.faults)),
            _ => {
                self.wrong(name, value, "a table");
                None
            }
        }
    }

    /// The tables of a list, such as `[[flights]]`.
    pub(in super::super) fn sections(&self, name: &'static str) -> Vec<Section<'a>> {
        let Some(value) = self.get(name) else { return vec![] };
        let Some(list) = value.get_ref().as_array() else {
            self.wrong(name, value, "a list of tables");
            return vec![];
        };
        let one = |v: &'a Spanned<DeValue<'a>>| match v.get_ref() {
            DeValue::Table(table) => Some(Section::new(name, table, v.span(), &self.faults)),
            _ => {
                self.wrong(name, v, "a list of tables");
                None
            }
        };
        list.iter().filter_map(one).collect()
    }

    /// All keys with numbers: for tables whose keys are names, such as currents.
    pub(in super::super) fn entries(&self) -> Vec<(String, f64, Range<usize>)> {
        let mut out = vec![];
        for (key, value) in self.table {
            match number(value.get_ref()).filter(|x| x.is_finite()) {
                Some(x) => out.push((key.get_ref().to_string(), x, key.span())),
                None => self.wrong(key.get_ref(), value, "a number"),
            }
        }
        out
    }

    /// Notes a fault at bytes of the spec.
    pub(in super::super) fn push(&self, fault: Fault) {
        self.faults.borrow_mut().push(fault);
    }

    /// Notes every key that nothing asked for, with the nearest that something did.
    pub(in super::super) fn finish(&self) {
        let asked = self.asked.borrow();
        for key in self.table.keys().filter(|k| !asked.contains(&k.get_ref().as_ref())) {
            let mut known = asked.clone();
            known.sort_unstable();
            known.dedup();
            let what = format!("`{}` has no key `{}`", self.name, key.get_ref());
            self.push(Fault::new(what).at(key.span()).nearest(key.get_ref(), &known));
        }
    }
}

fn number(value: &DeValue) -> Option<f64> {
    match value {
        DeValue::Float(x) => x.as_str().parse().ok(),
        DeValue::Integer(x) => i64::from_str_radix(x.as_str(), x.radix()).ok().map(|x| x as f64),
        _ => None,
    }
}
