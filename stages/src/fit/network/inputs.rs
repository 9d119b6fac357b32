//! Inputs of networks.

use std::sync::Arc;

use learning::inputs::{InputScaling, InputScalingError};
use schemas::Fault;

use super::{NetworkModel, warm_start::WarmStart};
use crate::fit::samples::FitSamples;

/// Inputs of a network. Networks with the same keys share these inputs.
pub struct NetworkInputs {
    /// Positions of the inputs among the features.
    pub at: Vec<usize>,
    /// Positions of features that are constant on the training lines and therefore not used.
    pub constant: Vec<usize>,
    /// Scaling of the inputs.
    pub scaling: InputScaling,
    /// Training lines and validation lines.
    pub lines: (Vec<usize>, Vec<usize>),
    /// Scaled inputs of training and validation lines, row-major.
    pub rows: (Vec<f64>, Vec<f64>),
}

/// Inputs that several networks may share.
pub type SharedInputs = Result<Arc<NetworkInputs>, Fault>;

impl NetworkInputs {
    /// Inputs of a network, with the scales of its warm start if it has one.
    ///
    /// # Errors
    /// Fails if the keys select no input, every input is constant, `whiten` requests too many components, or the warm
    /// start has other inputs.
    pub fn from_samples(
        model: &NetworkModel<'_>,
        samples: &FitSamples,
        whiten: Option<f64>,
        warm: Option<&WarmStart>,
    ) -> SharedInputs {
        let keys = model.keys;
        let lines = samples.split(&keys.validation)?;
        if !model.has_inputs() {
            let scaling = InputScaling { mean: vec![], scale: vec![], components: None };
            return Ok(Arc::new(Self { at: vec![], constant: vec![], scaling, lines, rows: (vec![], vec![]) }));
        }
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

/// Scaling of the inputs. Inputs that are constant on the training lines are removed from `at` and returned. The last
/// item holds the rows from which the scaling is computed (row-major).
///
/// # Errors
/// Fails if every input is constant, or `whiten` requests too many components.
pub fn scaling(
    samples: &FitSamples,
    lines: &[usize],
    at: &mut Vec<usize>,
    whiten: Option<f64>,
) -> Result<(InputScaling, Vec<usize>, Vec<f64>), Fault> {
    let mut constant = vec![];
    let mut x = samples.columns(at, lines);
    let mut found = InputScaling::standardised(&x, at.len());
    if let Err(InputScalingError::Constant { columns }) = &found {
        constant = columns.iter().filter_map(|&i| at.get(i).copied()).collect();
        at.retain(|i| !constant.contains(i));
        if at.is_empty() {
            return Err(Fault::data("every input is constant").of_param("inputs"));
        }
        x = samples.columns(at, lines);
        found = InputScaling::standardised(&x, at.len());
    }
    let fault = |e: InputScalingError| Fault::data(e.to_string());
    let scaling = found.map_err(fault)?;
    let scaling = match whiten {
        Some(keep) => scaling.whitened(&x, keep).map_err(|e| fault(e).of_param("whiten"))?,
        None => scaling,
    };
    Ok((scaling, constant, x))
}
