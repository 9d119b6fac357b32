//! Smoothing of a line as one window about the path of its filter: a fixed-interval smoother for any number of states.

use crate::navigation::aids::{AidInnovations, AidStates, Aids, SampleInnovations};
use crate::navigation::line::NavigationLine;
use crate::navigation::output::{Innovation, NavigationError};
use crate::navigation::pinson::{STATES, StateMatrix, StateVector};

use super::nodes::LineNodeBuilder;
use super::passage::FrontFilter;
use super::window::{MeasurementSource, SmoothingWindow};
use super::{FixedLagMagnetometer, FixedLagParameters, FixedLagUsage, WindowReport, layout, prior};

/// Smoothed line, solved as a single window.
#[derive(Clone, Debug, Default)]
pub(crate) struct WholeLineSolution {
    pub(crate) x: Vec<StateVector>,
    pub(crate) p: Vec<StateMatrix>,
    /// Innovations of the last forward pass, linearised along the path, with variances that exclude the factors of the
    /// loss.
    pub(crate) innovations: Vec<Innovation>,
    pub(crate) aids: AidInnovations,
    pub(crate) usage: Vec<FixedLagUsage>,
    pub(crate) slope_nt_per_m: Vec<f64>,
    pub(crate) report: WindowReport,
    pub(crate) offset: (f64, usize),
}

/// Smooths a checked line, with its scalar measurement and the further measurements. The iteration ends when no
/// position changes by more than `tolerance_m`.
pub(crate) fn smooth(
    parameters: &FixedLagParameters,
    line: &NavigationLine<'_>,
    aids: &Aids<'_>,
    tolerance_m: f64,
) -> Result<WholeLineSolution, NavigationError> {
    let magnetometers = [FixedLagMagnetometer::of_line(line)];
    let states = AidStates::new(aids, STATES + magnetometers.len());
    let layout = layout(&magnetometers, &states);
    let offset = line.predicted().offset(line.ins, line.measurement_nt, line.offset_window_s);
    let offsets_nt = [offset.0];
    let mut nodes = LineNodeBuilder::new(line, &magnetometers, &layout, &offsets_nt, 0.0).with(aids, &states);
    let start = prior(line, &magnetometers, &layout);
    let mut front = FrontFilter::new(parameters, &layout, line, (aids, &states), start.clone());
    let mut window = SmoothingWindow::new(parameters, &layout, line, (aids, &states), start);
    window.tolerance_m = tolerance_m;
    let (mut path, mut whole) = (vec![], WholeLineSolution { offset, ..WholeLineSolution::default() });
    while let Some(mut node) = nodes.take(f64::INFINITY) {
        let (row, tt_s) = (node.rows.start, node.tt_s);
        let estimate = front.take(&mut node);
        if !front.now.is_sound() {
            return Err(NavigationError::Diverged { row, tt_s });
        }
        whole.usage.push(estimate.usage);
        whole.slope_nt_per_m.push(estimate.slope_nt_per_m);
        path.extend_from_slice(&front.now.x);
        window.nodes.push(node);
    }
    let rows = window.nodes.len();
    whole.report = window.solve_from(path, &vec![true; rows]);
    whole.p = vec![[[0.0; STATES]; STATES]; rows];
    window.covariances(0..rows, |row, p| whole.p[row] = p);
    for row in 0..rows {
        let mut x = [0.0; STATES];
        x.copy_from_slice(&window.state(row)[..STATES]);
        let sound = (0..STATES).all(|state| x[state].is_finite() && whole.p[row][state][state] >= 0.0);
        if !sound {
            return Err(NavigationError::Diverged { row, tt_s: line.ins.tt_s[row] });
        }
        whole.x.push(x);
        let (mut of_field, mut further) = (Innovation::NONE, SampleInnovations::default());
        for trace in window.traces(row) {
            match trace.of {
                MeasurementSource::Magnetometer(_) => of_field = trace.innovation(),
                MeasurementSource::Aid(aid) => further.note(aid, trace.innovation()),
                MeasurementSource::Fix(_) => {}
            }
        }
        whole.innovations.push(if of_field.nis.is_nan() { further.difference } else { of_field });
        whole.aids.push(aids, &further);
    }
    Ok(whole)
}
