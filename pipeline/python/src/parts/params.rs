//! Parameters of a part: declared in Python, read from a spec, checked, and spelt like the parameters of built-in
//! stages.

use std::sync::Arc;

use pyo3::{prelude::*, types::PyDict};
use schemas::{Fault, Literal, ParamDoc, ParamReader, ParamValue, Rule};
use serde::Deserialize;
use serde_json::Value;

/// Type of a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
pub enum PartParamType {
    #[serde(rename = "number")]
    Number,
    #[serde(rename = "whole number")]
    Whole,
    #[serde(rename = "boolean")]
    Flag,
    #[serde(rename = "text")]
    Text,
    #[serde(rename = "list of numbers")]
    Numbers,
    #[serde(rename = "list of text")]
    Texts,
}

impl PartParamType {
    /// The name in the reference and in messages.
    fn words(self) -> &'static str {
        match self {
            PartParamType::Number => "number",
            PartParamType::Whole => "whole number",
            PartParamType::Flag => "boolean",
            PartParamType::Text => "text",
            PartParamType::Numbers => "list of numbers",
            PartParamType::Texts => "list of text",
        }
    }
}

/// A parameter, as Python declares it.
#[derive(Debug, Deserialize)]
pub struct PartParamDecl {
    name: String,
    #[serde(rename = "type")]
    kind: PartParamType,
    /// Whether an unset parameter without a default is `None`.
    optional: bool,
    /// `null` if the parameter is required or `optional`.
    default: Value,
    unit: String,
    doc: String,
    least: Option<f64>,
    most: Option<f64>,
    choices: Option<Vec<String>>,
}

/// A parameter of a part.
#[derive(Debug)]
pub struct PartParam {
    pub name: &'static str,
    pub kind: PartParamType,
    optional: bool,
    default: Option<PartValue>,
    unit: &'static str,
    doc: String,
    least: f64,
    most: f64,
    choices: Vec<String>,
}

/// Value of a parameter.
#[derive(Clone, Debug, PartialEq)]
pub enum PartValue {
    Unset,
    Flag(bool),
    Number(f64),
    Whole(i64),
    Text(String),
    Numbers(Vec<f64>),
    Texts(Vec<String>),
}

impl PartValue {
    /// The value of a literal; `None` if the type does not fit.
    fn read(kind: PartParamType, literal: &Literal) -> Option<PartValue> {
        Some(match kind {
            PartParamType::Number => PartValue::Number(f64::read(literal)?),
            PartParamType::Whole => match literal {
                Literal::Int(x) => PartValue::Whole(*x),
                _ => return None,
            },
            PartParamType::Flag => PartValue::Flag(bool::read(literal)?),
            PartParamType::Text => PartValue::Text(String::read(literal)?),
            PartParamType::Numbers => PartValue::Numbers(Vec::read(literal)?),
            PartParamType::Texts => PartValue::Texts(Vec::read(literal)?),
        })
    }

    /// Canonical spelling for the key of a result.
    fn canonical(&self) -> String {
        match self {
            PartValue::Unset => "none".to_owned(),
            PartValue::Flag(x) => x.canonical(),
            PartValue::Number(x) => x.canonical(),
            PartValue::Whole(x) => x.to_string(),
            PartValue::Text(x) => x.canonical(),
            PartValue::Numbers(x) => x.canonical(),
            PartValue::Texts(x) => x.canonical(),
        }
    }

    /// The strings of a string or a list of text; `None` for other values.
    fn texts(&self) -> Option<&[String]> {
        match self {
            PartValue::Text(one) => Some(std::slice::from_ref(one)),
            PartValue::Texts(all) => Some(all),
            PartValue::Unset
            | PartValue::Flag(_)
            | PartValue::Number(_)
            | PartValue::Whole(_)
            | PartValue::Numbers(_) => None,
        }
    }
}

/// The literal of a JSON value; `None` for an object or null.
fn literal(value: &Value) -> Option<Literal> {
    Some(match value {
        Value::Bool(x) => Literal::Bool(*x),
        Value::Number(x) => match x.as_i64() {
            Some(whole) => Literal::Int(whole),
            None => Literal::Float(x.as_f64()?),
        },
        Value::String(x) => Literal::Text(x.clone()),
        Value::Array(items) => Literal::List(items.iter().map(literal).collect::<Option<_>>()?),
        Value::Null | Value::Object(_) => return None,
    })
}

/// Text that is kept until the process ends. Each registration of a part adds the names of the part.
pub fn leaked(text: &str) -> &'static str {
    Box::leak(text.to_owned().into_boxed_str())
}

impl PartParam {
    /// The parameter of a declaration.
    ///
    /// # Errors
    /// Fails if its default is of another type or not permitted.
    pub fn new(decl: PartParamDecl) -> Result<PartParam, String> {
        let PartParamDecl { name, kind, optional, default, unit, doc, least, most, choices } = decl;
        let value = match &default {
            Value::Null => None,
            given => {
                let read = literal(given).and_then(|literal| PartValue::read(kind, &literal));
                Some(read.ok_or_else(|| format!("the default {given} of `{name}` is not a {}", kind.words()))?)
            }
        };
        let param = PartParam {
            name: leaked(&name),
            kind,
            optional,
            default: value,
            unit: leaked(&unit),
            doc,
            least: least.unwrap_or(f64::NEG_INFINITY),
            most: most.unwrap_or(f64::INFINITY),
            choices: choices.unwrap_or_default(),
        };
        if let Some(default) = &param.default {
            param.check(default).map_err(|fault| format!("the default: {fault}"))?;
        }
        Ok(param)
    }

    fn is_bounded(&self) -> bool {
        self.least.is_finite() || self.most.is_finite()
    }

    /// Checks the limits of numbers, and the permitted words.
    fn check(&self, value: &PartValue) -> Result<(), Fault> {
        let numbers: &[f64] = match value {
            PartValue::Number(x) => std::slice::from_ref(x),
            PartValue::Whole(x) => &[*x as f64],
            PartValue::Numbers(all) => all,
            PartValue::Unset | PartValue::Flag(_) | PartValue::Text(_) | PartValue::Texts(_) => &[],
        };
        let name = self.name;
        if let Some(x) = numbers.iter().find(|x| !x.is_finite() || !(self.least..=self.most).contains(*x)) {
            let words = if self.is_bounded() { self.rule() } else { Rule::Finite.words() };
            return Err(Fault::new(format!("`{name}` must be {words}, not {x}")).of_param(name));
        }
        let other = |word: &&String| !self.choices.is_empty() && !self.choices.contains(word);
        match value.texts().unwrap_or_default().iter().find(other) {
            Some(word) => {
                Err(Fault::new(format!("`{name}` cannot be `{word}`")).nearest(word, &self.choices).of_param(name))
            }
            None => Ok(()),
        }
    }

    /// Permitted values, in words.
    fn rule(&self) -> String {
        match (self.least.is_finite(), self.most.is_finite()) {
            (true, true) => Rule::Between(self.least, self.most).words(),
            (true, false) => format!("{} or above", self.least),
            (false, true) => format!("{} or below", self.most),
            (false, false) => self.choices.iter().map(|word| format!("`{word}`")).collect::<Vec<_>>().join(", "),
        }
    }

    /// Documentation for the reference.
    pub fn document(&self) -> ParamDoc {
        ParamDoc {
            name: self.name,
            type_name: self.kind.words(),
            unit: self.unit,
            default: self.default.as_ref().map(PartValue::canonical),
            absent: (self.default.is_none() && self.optional).then_some("`None`"),
            rule: self.rule(),
            doc: self.doc.clone(),
            owners: vec![],
            keys: vec![],
        }
    }

    /// Reads the value. `None` if the value is missing or invalid; the reader then holds the fault.
    fn read(&self, reader: &mut ParamReader) -> Option<PartValue> {
        let Some(given) = reader.given(self.name) else {
            let unset = self.default.clone().or_else(|| self.optional.then_some(PartValue::Unset));
            if unset.is_none() {
                reader.missing(self.name, &[&self.doc]);
            }
            return unset;
        };
        let Some(value) = PartValue::read(self.kind, &given.value) else {
            reader.wrong_type(self.name, self.kind.words(), given);
            return None;
        };
        match self.check(&value) {
            Ok(()) => Some(value),
            Err(fault) => {
                reader.push(fault.at(given.at.clone()));
                None
            }
        }
    }
}

/// Values of all parameters of a part.
#[derive(Clone, Debug, PartialEq)]
pub struct PartValues(Arc<Vec<(&'static str, PartValue)>>);

impl PartValues {
    /// Reads the parameters. `None` if there are faults; the reader then holds them.
    pub fn read(params: &[PartParam], reader: &mut ParamReader) -> Option<PartValues> {
        // All parameters are read, so that all faults are reported.
        let read: Vec<Option<PartValue>> = params.iter().map(|param| param.read(reader)).collect();
        let values = params.iter().zip(read).map(|(param, value)| Some((param.name, value?)));
        values.collect::<Option<Vec<_>>>().map(|values| PartValues(Arc::new(values)))
    }

    /// Adds every parameter in canonical spelling.
    pub fn spell(&self, out: &mut Vec<(&'static str, String)>) {
        out.extend(self.0.iter().map(|(name, value)| (*name, value.canonical())));
    }

    /// The values as keyword arguments.
    ///
    /// # Errors
    /// Fails if Python runs out of memory.
    pub fn arguments<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let found = PyDict::new(py);
        for (name, value) in self.0.iter() {
            match value {
                PartValue::Unset => found.set_item(name, py.None())?,
                PartValue::Flag(x) => found.set_item(name, x)?,
                PartValue::Number(x) => found.set_item(name, x)?,
                PartValue::Whole(x) => found.set_item(name, x)?,
                PartValue::Text(x) => found.set_item(name, x)?,
                PartValue::Numbers(x) => found.set_item(name, x)?,
                PartValue::Texts(x) => found.set_item(name, x)?,
            }
        }
        Ok(found)
    }

    /// Names from a template: `{column}_bp` contains the text of the parameter `column`; if the parameter is a list of
    /// text, there is one name for each element.
    ///
    /// # Errors
    /// Fails if a parameter between braces is missing or not text.
    pub fn expand(&self, template: &str) -> Result<Vec<String>, Fault> {
        let Some((before, rest)) = template.split_once('{') else { return Ok(vec![template.to_owned()]) };
        let (name, after) = rest.split_once('}').unwrap_or((rest, ""));
        let value = self.0.iter().find(|(known, _)| *known == name).map(|(_, value)| value);
        let texts = value.and_then(PartValue::texts);
        let texts = texts.ok_or_else(|| Fault::new(format!("`{name}` in `{template}` is not a text parameter")))?;
        let ends = self.expand(after)?;
        Ok(texts.iter().flat_map(|text| ends.iter().map(move |end| format!("{before}{text}{end}"))).collect())
    }
}
