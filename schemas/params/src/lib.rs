//! Typed parameters: declared once by [`params!`], read from TOML with the position of every key, checked, documented and
//! spelt for a key.
//!
//! A group of parameters is a struct whose fields say unit, default, rule and documentation. Groups nest ([`Nested`],
//! [`Sections`]), are shared (`groups`), and hold choices among words ([`choice!`]) or among [kinds](Kind) with keys of
//! their own ([`Chosen`]), such as the models of a fit. Everything that a user can get wrong becomes a [`Fault`] with its
//! position and a way out.

mod fault;
mod group;
mod kind;
pub mod paths;
mod section;
mod value;
mod visible;

pub use fault::{Fault, Owner, Place, nearest, render};
pub use group::{Nested, Param, ParamDoc, Params, Reader, Sections, collect_doc, first, no_text, obeys, words_rule};
pub use kind::{Chosen, Kind, Kinds, Lists, Own, Several};
pub use section::{Args, Given, Section, literal};
pub use value::{Literal, OrAuto, Rule, Value, Word};
pub use visible::{one_line, visible};
