//! A value in a spec, and the condition on the value of a parameter.

use std::fmt;

use crate::{Fault, SpecSection};

/// A value in the spec, with its type.
#[derive(Clone, Debug, PartialEq)]
pub enum Literal {
    /// `true` or `false`.
    Bool(bool),
    /// A whole number.
    Int(i64),
    /// A number with a fraction or exponent.
    Float(f64),
    /// Text.
    Text(String),
    /// A list of values.
    List(Vec<Literal>),
    /// A table.
    Section(SpecSection),
}

impl Literal {
    /// The name of its type.
    pub fn type_name(&self) -> &'static str {
        match self {
            Literal::Bool(_) => "boolean",
            Literal::Int(_) => "whole number",
            Literal::Float(_) => "number",
            Literal::Text(_) => "text",
            Literal::List(_) => "list",
            Literal::Section(_) => "table",
        }
    }

    /// The text, if the value is text.
    pub fn as_text(&self) -> Option<&str> {
        if let Literal::Text(s) = self { Some(s) } else { None }
    }
}

impl fmt::Display for Literal {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Literal::Bool(x) => write!(f, "{x}"),
            Literal::Int(x) => write!(f, "{x}"),
            Literal::Float(x) => write!(f, "{x}"),
            Literal::Text(x) => write!(f, "{x}"),
            Literal::List(xs) => {
                let words: Vec<String> = xs.iter().map(Literal::to_string).collect();
                write!(f, "{}", words.join("+"))
            }
            Literal::Section(section) => {
                let pairs: Vec<String> = section.keys.iter().map(|(key, g)| format!("{key} = {}", g.value)).collect();
                write!(f, "{{{}}}", pairs.join(", "))
            }
        }
    }
}

/// Condition on a parameter's value in addition to its type.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rule {
    /// Any value of the type.
    Any,
    /// Finite.
    Finite,
    /// Finite and above zero.
    Positive,
    /// Finite and not below zero.
    NotNegative,
    /// Within the two limits, both included.
    Between(f64, f64),
    /// One of these words; for a list, each element is one of them.
    OneOf(&'static [&'static str]),
}

impl Rule {
    /// The rule in words; empty for [`Rule::Any`].
    pub fn words(&self) -> String {
        match self {
            Rule::Any => String::new(),
            Rule::Finite => "finite".to_owned(),
            Rule::Positive => "above 0".to_owned(),
            Rule::NotNegative => "0 or above".to_owned(),
            Rule::Between(a, b) => format!("{a} to {b}"),
            Rule::OneOf(words) => words.iter().map(|w| format!("`{w}`")).collect::<Vec<_>>().join(", "),
        }
    }

    pub(crate) fn number(&self, x: f64) -> Result<(), Fault> {
        let fine = match self {
            Rule::Finite => x.is_finite(),
            Rule::Positive => x.is_finite() && x > 0.0,
            Rule::NotNegative => x.is_finite() && x >= 0.0,
            Rule::Between(a, b) => (*a..=*b).contains(&x),
            Rule::Any | Rule::OneOf(_) => !x.is_nan(),
        };
        let words = if *self == Rule::Any { "a number".to_owned() } else { self.words() };
        if fine { Ok(()) } else { Err(Fault::new(format!("must be {words}, not {x}"))) }
    }

    pub(crate) fn word(&self, x: &str) -> Result<(), Fault> {
        match self {
            Rule::OneOf(known) if !known.contains(&x) => Err(Fault::new(format!("cannot be `{x}`")).nearest(x, known)),
            _ => Ok(()),
        }
    }
}
