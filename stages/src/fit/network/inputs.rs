//! The inputs of networks.

use std::sync::Arc;

use learning::inputs::{Inputs, InputsError};
use schemas::Fault;

use super::{Network, warm_start::WarmStart};
use crate::fit::samples::Samples;

/// The inputs of a network, which networks with the same keys share.
pub struct NetworkInputs {
    /// Their places among the features.
    pub at: Vec<usize>,
    /// The places of those that are constant on the lines to train on, which are none.
    pub constant: Vec<usize>,
    /// How they are scaled.
    pub scaling: Inputs,
    /// The lines to train on, and those to validate with.
    pub lines: (Vec<usize>, Vec<usize>),
    /// The scaled inputs of both, row-major.
    pub rows: (Vec<f64>, Vec<f64>),
}

/// Inputs that several networks may share.
pub type SharedInputs = Result<Arc<NetworkInputs>, Fault>;

impl NetworkInputs {
    /// Inputs of a network, with the scales of its warm start where it has one.
    ///
    /// # Errors
    /// When the keys name none, every input is constant, there are no components as `whiten` asks for, or the network to begin
    /// with has others.
    pub fn of(keys: &Network, samples: &Samples, whiten: Option<f64>, warm: Option<&WarmStart>) -> SharedInputs {
        let lines = samples.split(&keys.validation)?;
        let mut at = samples.places(keys.inputs.as_ref()).map_err(|f| f.of_param("inputs"))?;
        let (scaling, constant, x) = match warm {
            None => scaling(samples, &lines.0, &mut at, whiten)?,
            Some(warm) => {
                let scaling = warm.scaling(samples, &mut at, whiten)?;
                let x = samples.columns(&at, &lines.0);
                (scaling, vec![], x)
            }
        };
        let rows = (scaling.apply(&x), scaling.apply(&samples.columns(&at, &lines.1)));
        Ok(Arc::new(Self { at, constant, scaling, lines, rows }))
    }
}

/// How the inputs are scaled; those that are constant on the lines to train on are taken out of `at`, and returned. The last
/// are the rows of the lines that the scaling is made of, row-major.
///
/// # Errors
/// When every input is constant, or there are no components as `whiten` asks for.
pub fn scaling(
    samples: &Samples,
    lines: &[usize],
    at: &mut Vec<usize>,
    whiten: Option<f64>,
) -> Result<(Inputs, Vec<usize>, Vec<f64>), Fault> {
    let mut constant = vec![];
    let mut x = samples.columns(at, lines);
    let mut found = Inputs::standardised(&x, at.len());
    if let Err(InputsError::Constant { columns }) = &found {
        constant = columns.iter().filter_map(|&i| at.get(i).copied()).collect();
        at.retain(|i| !constant.contains(i));
        if at.is_empty() {
            return Err(Fault::data("every input is constant").of_param("inputs"));
        }
        x = samples.columns(at, lines);
        found = Inputs::standardised(&x, at.len());
    }
    let fault = |e: InputsError| Fault::data(e.to_string());
    let scaling = found.map_err(fault)?;
    let scaling = match whiten {
        Some(keep) => scaling.whitened(&x, keep).map_err(|e| fault(e).of_param("whiten"))?,
        None => scaling,
    };
    Ok((scaling, constant, x))
}
