//! Maps of dipoles and prisms with a closed form at any point.

use crate::maps::magnetic_sources::*;
use crate::maps::plane_grid::{EvenAxis, PlaneGrid};

/// Placement of the sources.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Scene {
    /// All well inside the map.
    Inside,
    /// Random positions on the map and in an equally wide margin around the map.
    Around,
    /// Around, with some deep and strong sources.
    Regional,
}

/// A core field with an inclination of 69°.
pub(super) fn main_field() -> EastNorthUp {
    direction(69.0, 6.0)
}

/// Sources magnetised along the core field, and the axes of the map above the sources.
pub(super) struct Field {
    pub(super) sources: Vec<MagneticBody>,
    east_m: EvenAxis,
    north_m: EvenAxis,
}

pub(super) struct Random(u64);

impl Random {
    pub(super) fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
    }

    /// Uniform number between 0 and 1 (xorshift).
    pub(super) fn even(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.even()
    }

    /// Approximately normal number of unit variance.
    pub(super) fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.even()).sum::<f64>() - 6.0
    }
}

impl Field {
    /// A map of `[rows, columns]` nodes 100 m apart at height 0.
    pub(super) fn new(scene: Scene, seed: u64, [rows, columns]: [usize; 2]) -> Self {
        let mut random = Random::new(seed);
        let sides = [columns, rows].map(|n| 100.0 * (n - 1) as f64);
        let count = if scene == Scene::Inside { 30 } else { 90 };
        let margin = if scene == Scene::Inside { -0.15 } else { 0.8 };
        let sources = (0..count)
            .map(|_| {
                let mut along = |side: f64| side * random.between(-margin, 1.0 + margin);
                let (east, north) = (along(sides[0]), along(sides[1]));
                let deep = scene == Scene::Regional && random.even() > 0.8;
                let depth = if deep { random.between(3000.0, 9000.0) } else { random.between(250.0, 1500.0) };
                source([east, north, -depth], random.normal(), &mut random)
            })
            .collect();
        let axis = |len| EvenAxis { first: 0.0, step: 100.0, len };
        Self { sources, east_m: axis(columns), north_m: axis(rows) }
    }

    pub(super) fn vector_at(&self, [east, north, up]: EastNorthUp) -> EastNorthUp {
        field_of_all_nt(&self.sources, [east, north, up])
    }

    /// A quantity on the map's nodes, each at its own height.
    pub(super) fn on(&self, height: impl Fn(usize) -> f64, of: impl Fn(EastNorthUp) -> f64) -> PlaneGrid {
        let columns = self.east_m.len;
        let point = |node: usize| {
            [self.east_m.at((node % columns) as f64), self.north_m.at((node / columns) as f64), height(node)]
        };
        let values = (0..self.north_m.len * columns).map(|node| of(point(node))).collect();
        PlaneGrid { east_m: self.east_m, north_m: self.north_m, values }
    }

    pub(super) fn anomaly_at(&self, point: EastNorthUp) -> f64 {
        total_field_anomaly_nt(self.vector_at(point), main_field())
    }

    /// The total-field anomaly at a height.
    pub(super) fn anomaly(&self, up_m: f64) -> PlaneGrid {
        self.on(|_| up_m, |point| self.anomaly_at(point))
    }
}

/// A dipole or a prism that produces some 100 nT at height 0.
fn source(at: EastNorthUp, strength: f64, random: &mut Random) -> MagneticBody {
    let depth = -at[2];
    let moment = main_field().map(|c| c * strength * 0.5 * depth.powi(3));
    if random.even() < 0.92 {
        return MagneticBody::Dipole(Dipole { at_m: at, moment_am2: moment });
    }
    let half = [0.4, 0.3, 0.3].map(|part| part * depth);
    let volume = 8.0 * half[0] * half[1] * half[2];
    MagneticBody::Prism(Prism {
        low_m: [0, 1, 2].map(|i| at[i] - half[i]),
        high_m: [0, 1, 2].map(|i| at[i] + half[i]),
        magnetisation_apm: moment.map(|m| m / volume),
    })
}

/// The rms over the nodes that `keep` selects by row and column.
pub(super) fn rms_where(map: &PlaneGrid, keep: impl Fn(usize, usize) -> bool) -> f64 {
    let columns = map.columns();
    let kept: Vec<f64> =
        map.values.iter().enumerate().filter(|(i, _)| keep(i / columns, i % columns)).map(|(_, v)| *v).collect();
    assert!(!kept.is_empty());
    (kept.iter().map(|v| v * v).sum::<f64>() / kept.len() as f64).sqrt()
}

pub(super) fn minus(one: &PlaneGrid, other: &PlaneGrid) -> PlaneGrid {
    one.with(one.values.iter().zip(&other.values).map(|(a, b)| a - b).collect())
}

/// Number of nodes between a node and the nearest edge.
pub(super) fn depth(map: &PlaneGrid, row: usize, column: usize) -> usize {
    row.min(column).min(map.rows() - 1 - row).min(map.columns() - 1 - column)
}
