//! Columns of a network: inputs, and the terms of its linear model.

use learning::network::VectorFrame;

use super::terms::{TermLookup, TermValue, named_list, term};
use schemas::Fault;

/// Inputs and linear terms of a network, and the vector form of the terms, if any.
#[derive(Clone, Debug, PartialEq)]
pub struct NetworkColumns {
    /// The names of the inputs.
    pub(super) inputs: Vec<String>,
    /// The names of the linear terms.
    pub(super) linear: Vec<String>,
    /// Vector form of the linear terms.
    pub(super) frame: Option<VectorFrame>,
    /// Names of the inputs, then of the linear terms that are not inputs; and the positions of all linear terms among
    /// these names.
    pub(super) all: Vec<String>,
    pub(super) linear_at: Vec<usize>,
}

impl NetworkColumns {
    /// Columns with these inputs and linear terms.
    pub fn new(inputs: Vec<String>, linear: Vec<String>, frame: Option<VectorFrame>) -> Self {
        let mut all = inputs.clone();
        let mut place = |name: &String| {
            all.iter().position(|c| c == name).unwrap_or_else(|| {
                all.push(name.clone());
                all.len() - 1
            })
        };
        let linear_at = linear.iter().map(&mut place).collect();
        Self { inputs, linear, frame, all, linear_at }
    }

    /// Splits rows of all columns into the inputs and the linear terms, both row-major.
    pub(super) fn split(&self, x: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let rows = || x.chunks_exact(self.all.len().max(1));
        let own = self.inputs.len();
        let inputs: Vec<f64> = rows().flat_map(|row| row.iter().take(own).copied()).collect();
        let linear = rows().flat_map(|row| self.linear_at.iter().filter_map(|&i| row.get(i).copied())).collect();
        (inputs, linear)
    }

    /// Rows of linear terms in the form that a network requires.
    pub(super) fn rows(&self, linear: Vec<f64>) -> Vec<f64> {
        match self.frame {
            Some(frame) => frame.rows(&linear, self.linear.len()),
            None => linear,
        }
    }

    /// The terms of the table.
    pub(super) fn linear_terms(&self) -> Vec<TermValue> {
        let mut out: Vec<TermValue> = named_list("linear_term", &self.linear, &vec![1.0; self.linear.len()]).collect();
        if let Some(frame) = self.frame {
            out.push(term(format!("coupling {}", frame.coupling.word()), 1.0));
            out.push(term("bt_scale_nt", frame.bt_scale_nt));
        }
        out
    }

    /// Reads the columns of a table; `vector` is true for a vector form.
    ///
    /// # Errors
    /// Fails if the table is incomplete.
    pub(super) fn read(terms: &TermLookup, inputs: Vec<String>, vector: bool) -> Result<Self, Fault> {
        let (linear, _) = terms.list("linear_term")?;
        let frame = || -> Result<VectorFrame, Fault> {
            Ok(VectorFrame {
                coupling: terms.choice("coupling")?,
                bt_scale_nt: terms.value("bt_scale_nt")?,
                target_scale_nt: terms.value("target_scale")?,
            })
        };
        Ok(Self::new(inputs, linear, if vector { Some(frame()?) } else { None }))
    }
}
