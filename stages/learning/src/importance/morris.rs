//! Elementary effects: the screening method of Morris.

use numerics::random::{SplitMix64, seed_of};

use super::ranges::UnitCube;
use super::{ImportanceError, PredictionFunction};
use crate::{
    draws,
    rows::{entries, setting},
};

/// Sampling of elementary effects.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MorrisDesign {
    /// Number of trajectories, at least 2. A trajectory needs one prediction more than there are groups.
    pub trajectories: usize,
    /// Number p of levels of each column, even. A step is p/(2 (p − 1)) of the range.
    pub levels: usize,
    /// Seed of the trajectories.
    pub seed: u64,
}

/// Elementary effects of one group, in the unit of the prediction per range of the column.
#[derive(Debug, Clone, PartialEq)]
pub struct ElementaryEffects {
    /// Effect in each trajectory. For a group of several columns, which move together, the absolute value of the
    /// effect.
    pub effects: Vec<f64>,
}

impl ElementaryEffects {
    /// Mean absolute effect μ* [Campolongo, Cariboni & Saltelli 2007].
    pub fn mean_absolute(&self) -> f64 {
        self.effects.iter().map(|effect| effect.abs()).sum::<f64>() / self.effects.len() as f64
    }

    /// Standard deviation σ of the effects, which is 0 for a linear model without interaction.
    pub fn deviation(&self) -> f64 {
        deviation(self.effects.iter().copied())
    }

    /// Standard error of [`ElementaryEffects::mean_absolute`], for independent trajectories.
    pub fn error(&self) -> f64 {
        deviation(self.effects.iter().map(|effect| effect.abs())) / (self.effects.len() as f64).sqrt()
    }
}

/// Standard deviation, with the divisor n − 1.
fn deviation(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let count = values.clone().count() as f64;
    let mean = values.clone().sum::<f64>() / count;
    (values.map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0)).sqrt()
}

/// Elementary effects of groups of columns over their `ranges` (lower and upper bound) [Morris 1991].
///
/// A trajectory begins at a random point of a grid with p levels per column. It moves one group at a time, in random
/// order, by a step Δ of the range. Each step gives one effect (y₂ − y₁)/±Δ. The columns of a group move together, each
/// in its own random direction. A column without a range has no effect.
///
/// # Errors
/// Fails for invalid ranges, groups or settings. Also fails if the model fails or returns anything but one finite
/// number per row.
pub fn morris<E: Send>(
    model: &PredictionFunction<'_, E>,
    ranges: &[[f64; 2]],
    groups: &[Vec<usize>],
    design: &MorrisDesign,
) -> Result<Vec<ElementaryEffects>, ImportanceError<E>> {
    let cube = UnitCube { model, ranges };
    cube.check(groups)?;
    setting("the number of trajectories", design.trajectories as f64, "at least 2", design.trajectories >= 2)?;
    let is_even = design.levels >= 2 && design.levels.is_multiple_of(2);
    setting("the number of levels", design.levels as f64, "even and at least 2", is_even)?;
    let points = trajectories(ranges.len(), groups, design);
    let y = cube.predict(&points)?;
    elementary_effects(&points, &y, groups, design.levels)
}

/// Computes effects from the points of trajectories in the unit cube and from the predictions at these points. Each
/// trajectory has one point more than there are groups. Consecutive points differ in the columns of one group.
///
/// # Errors
/// Fails for a wrong number of points, or for a trajectory that does not move each group once.
pub fn elementary_effects<E>(
    points: &[f64],
    y: &[f64],
    groups: &[Vec<usize>],
    levels: usize,
) -> Result<Vec<ElementaryEffects>, ImportanceError<E>> {
    let (width, length) = (groups.iter().map(Vec::len).sum::<usize>(), groups.len() + 1);
    entries("the points", points.len(), y.len() * width)?;
    entries("the incomplete trajectory at the end of the predictions", y.len() % length, 0)?;
    let step = step(levels);
    let mut all = vec![ElementaryEffects { effects: Vec::with_capacity(y.len() / length) }; groups.len()];
    for (points, y) in points.chunks_exact(length * width).zip(y.chunks_exact(length)) {
        for (place, pair) in y.windows(2).enumerate() {
            let (from, to) = points[place * width..][..2 * width].split_at(width);
            let moved = |column: usize| to[column] - from[column];
            let group = groups.iter().position(|columns| columns.iter().any(|j| moved(*j).abs() > 0.5 * step));
            // If a step moves no group, some group has too few effects, which is rejected below.
            let Some(group) = group else { continue };
            let change = (pair[1] - pair[0]) / step;
            all[group].effects.push(match groups[group][..] {
                [column] => change * moved(column).signum(),
                _ => change.abs(),
            });
        }
    }
    let count = y.len() / length;
    match all.iter().position(|of| of.effects.len() != count) {
        Some(group) => Err(ImportanceError::Group { group, what: "must move exactly once in each trajectory" }),
        None => Ok(all),
    }
}

/// Step Δ as a fraction of the range.
fn step(levels: usize) -> f64 {
    levels as f64 / (2.0 * (levels as f64 - 1.0))
}

/// Points of all trajectories in the unit cube, row-major.
fn trajectories(width: usize, groups: &[Vec<usize>], design: &MorrisDesign) -> Vec<f64> {
    let (step, levels) = (step(design.levels), design.levels);
    let mut bits = SplitMix64::new(seed_of(design.seed, &["morris"]));
    let mut points = Vec::with_capacity(design.trajectories * (groups.len() + 1) * width);
    for _ in 0..design.trajectories {
        let mut point = Vec::with_capacity(width);
        let mut rises = Vec::with_capacity(width);
        for _ in 0..width {
            // The lower of the two values of the column: a level from which a step stays in the range.
            let low = draws::below(&mut bits, levels / 2) as f64 / (levels - 1) as f64;
            let is_low = draws::below(&mut bits, 2) == 0;
            point.push(if is_low { low } else { low + step });
            rises.push(is_low);
        }
        points.extend(&point);
        for group in draws::shuffled(&mut bits, groups.len()) {
            for &column in &groups[group] {
                point[column] += if rises[column] { step } else { -step };
            }
            points.extend(&point);
        }
    }
    points
}
