//! Typed parameters: declared once by [`params!`], read from TOML with the position of every key, checked, documented
//! and spelt for a key.
//!
//! A group of parameters is a struct whose fields say unit, default, rule and documentation. Groups nest
//! ([`NestedParams`], [`ParamsList`]), are shared (`groups`), and hold choices among words ([`choice!`]) or among
//! [kinds](ChoiceKind) with keys of their own ([`ChoiceSelection`]), such as the models of a fit. Everything that a
//! user can get wrong becomes a [`Fault`] with its position and a way out.

mod fault;
mod group;
mod kind;
pub mod paths;
mod section;
mod value;
mod visible;

pub use fault::{DataLocation, Fault, FaultOwner, nearest, render};
pub use group::{
    NestedParams, Param, ParamDoc, ParamReader, Params, ParamsList, collect_doc, first, no_text, obeys, words_rule,
};
pub use kind::{ChoiceKeys, ChoiceKind, ChoiceList, ChoiceRegistry, ChoiceSelection, ChoiceSubset};
pub use section::{SpecEntries, SpecEntry, SpecSection, literal};
pub use value::{Literal, NumberOrAuto, ParamValue, Rule, VerbatimText};
pub use visible::{one_line, visible};
