//! The simulation of lines in their order, some of them in parallel.
//!
//! Only the INS of a line depends on earlier lines of its flight. The truth of the next lines is therefore computed
//! first, then the field and the sensors of each line, in parallel with the INS of each flight. The results equal those
//! of a sequential simulation.

use std::{collections::VecDeque, sync::Arc};

use datasets::{ReadError, table::ColumnTable};
use rayon::prelude::*;

use super::{SimulationContext, ins, scene::SynthLineContext, trajectory::TrueTrajectory};

/// The INS output along some lines of a flight, up to the first line on which the INS fails.
type InsLineOutputs = Vec<Result<[Vec<f64>; 13], ReadError>>;

/// Iterator over the simulated lines, several of which are computed in parallel.
pub(crate) struct LineSimulator {
    world: Arc<SimulationContext>,
    /// Indices of the flight and the line, for lines that are not started.
    left: VecDeque<(usize, usize)>,
    /// The number of lines that are simulated in parallel.
    at_once: usize,
    /// The current flight, and its INS.
    ins: Option<(usize, ins::FlightIns)>,
    ready: VecDeque<Result<ColumnTable, ReadError>>,
}

impl LineSimulator {
    pub(super) fn new(world: Arc<SimulationContext>, flights: std::ops::Range<usize>, at_once: usize) -> LineSimulator {
        let all = &world.simulation.spec.flights;
        let lines = |flight: usize| all.get(flight).map_or(0, |f| f.lines.len());
        let left = flights.flat_map(|flight| (0..lines(flight)).map(move |line| (flight, line))).collect();
        LineSimulator { world, left, at_once: at_once.max(1), ins: None, ready: VecDeque::new() }
    }

    /// Simulates the next lines, up to the first line that fails.
    fn advance(&mut self) -> Result<(), ReadError> {
        let world = self.world.clone();
        let (path, spec) = (&world.simulation.path, &world.simulation.spec);
        let next: Vec<(usize, usize)> = self.left.drain(..self.at_once.min(self.left.len())).collect();
        let field = world.field()?;
        let scene = |&(flight, line): &(usize, usize)| {
            let flight = &spec.flights[flight];
            SynthLineContext { path, spec, flight, line: &flight.lines[line] }
        };
        let scenes: Vec<SynthLineContext> = next.iter().map(scene).collect();
        let lines: Vec<(&SynthLineContext, TrueTrajectory)> =
            scenes.iter().zip(each(scenes.iter().collect(), SynthLineContext::fly)).collect();
        let mut flights = vec![];
        for (flight, lines) in next.iter().map(|(flight, _)| *flight).zip(&lines) {
            match flights.last_mut() {
                Some((last, _, of_flight)) if *last == flight => Vec::push(of_flight, lines),
                _ => flights.push((flight, self.ins.take_if(|(known, _)| *known == flight).map(|i| i.1), vec![lines])),
            }
        }
        let around = || each(lines.iter().collect(), |(scene, truth)| scene.around(truth, &field));
        let along = || each(flights, |(flight, run, lines)| (flight, navigate(run, &lines)));
        let (around, along) = if next.len() == 1 {
            let along = along();
            (around(), along)
        } else {
            rayon::join(around, along)
        };
        let (mut ins_lines, mut last) = (vec![], None);
        for (flight, (of_flight, run)) in along {
            ins_lines.extend(of_flight);
            last = run.map(|run| (flight, run));
        }
        self.ins = last;
        for ((scene, truth), (ins_lines, around)) in lines.into_iter().zip(ins_lines.into_iter().zip(around)) {
            let table = scene.table(&truth, ins_lines?, around?);
            self.ready.push_back(Ok(table));
        }
        Ok(())
    }
}

/// Advances the INS of a flight along its next lines.
fn navigate(
    run: Option<ins::FlightIns>,
    lines: &[&(&SynthLineContext, TrueTrajectory)],
) -> (InsLineOutputs, Option<ins::FlightIns>) {
    let Some((first, _)) = lines.first() else { return (vec![], run) };
    let begun = run.map_or_else(|| ins::FlightIns::new(first.path, first.spec, first.flight), Ok);
    let mut run = match begun {
        Ok(run) => run,
        Err(fault) => return (vec![Err(fault)], None),
    };
    let mut ins_lines = vec![];
    for (scene, truth) in lines {
        ins_lines.push(run.line(scene, truth));
        if ins_lines.last().is_some_and(Result::is_err) {
            // Later lines are not needed, because the lines end at the first line that fails.
            break;
        }
    }
    (ins_lines, Some(run))
}

/// Applies `one` to each element of `all`, in parallel if there are several.
fn each<T: Send, R: Send>(mut all: Vec<T>, one: impl Fn(T) -> R + Send + Sync) -> Vec<R> {
    match (all.len(), all.pop()) {
        (1, Some(only)) => vec![one(only)],
        (_, last) => {
            all.extend(last);
            all.into_par_iter().map(one).collect()
        }
    }
}

impl Iterator for LineSimulator {
    type Item = Result<ColumnTable, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ready.is_empty()
            && !self.left.is_empty()
            && let Err(fault) = self.advance()
        {
            self.left.clear();
            self.ready.push_back(Err(fault));
        }
        self.ready.pop_front()
    }
}
