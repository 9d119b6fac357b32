//! The attitude as columns: direction cosines, and products of sines and cosines.
//!
//! Names and definitions are those of MagNav.jl's `get_x`, thesis 000 appendix C.

use std::f64::consts::{PI, TAU};
use std::ops::Range;

use super::{Columns, FeatureError, difference_in_runs, same_length};
use crate::numerics::attitude::body_to_ned;
use crate::numerics::difference::Scheme;

/// The products of two and three that MagNav.jl has; c and s are cosine and sine, r, p and y roll, pitch and yaw.
const PRODUCTS: [&str; 20] = [
    "crcy", "cpcy", "crsy", "cpsy", "srcy", "spcy", "srsy", "spsy", "crcpcy", "srcpcy", "crspcy", "srspcy", "crcpsy",
    "srcpsy", "crspsy", "srspsy", "crcp", "srcp", "crsp", "srsp",
];
const ANGLES: [&str; 3] = ["roll", "pitch", "yaw"];
const FORMS: [&str; 5] = ["fdm", "sin", "cos", "sin_fdm", "cos_fdm"];

/// Roll, pitch and yaw of each sample, in radians.
#[derive(Debug, Clone, Copy)]
pub struct Attitude<'a> {
    /// Rotation about the nose, right wing down.
    pub roll_rad: &'a [f64],
    /// Nose up.
    pub pitch_rad: &'a [f64],
    /// Clockwise from north.
    pub yaw_rad: &'a [f64],
}

/// The names of all features of the attitude: `dcm_1` to `dcm_9`, the products, and `roll_fdm`, `roll_sin`, `roll_cos`,
/// `roll_sin_fdm`, `roll_cos_fdm` and the like of pitch and yaw.
pub fn names() -> Vec<String> {
    let cosines = (1..=9).map(|k| format!("dcm_{k}"));
    let products = PRODUCTS.iter().map(|name| (*name).to_owned());
    let angles = ANGLES.iter().flat_map(|angle| FORMS.iter().map(move |form| format!("{angle}_{form}")));
    cosines.chain(products).chain(angles).collect()
}

impl Attitude<'_> {
    fn angles(&self) -> [&[f64]; 3] {
        [self.roll_rad, self.pitch_rad, self.yaw_rad]
    }

    fn rows(&self) -> Result<usize, FeatureError> {
        let rows = self.roll_rad.len();
        same_length("the pitch", self.pitch_rad.len(), rows)?;
        same_length("the yaw", self.yaw_rad.len(), rows)?;
        Ok(rows)
    }

    /// One feature by its name: without a unit, but for `_fdm` of an angle in rad per sample.
    ///
    /// `dcm_k` are the elements of the matrix from north-east-down to body, down its columns. A difference of an
    /// angle takes the shorter way round, where MagNav.jl's yaw jumps by 2π at south.
    pub fn feature(&self, name: &str, runs: &[Range<usize>]) -> Result<Vec<f64>, FeatureError> {
        let rows = self.rows()?;
        if let Some(number) = name.strip_prefix("dcm_").and_then(|k| k.parse::<usize>().ok())
            && (1..=9).contains(&number)
        {
            // Down the columns of the transpose is along the rows of body to ned.
            let (row, column) = ((number - 1) / 3, (number - 1) % 3);
            let entry = |i: usize| body_to_ned(self.roll_rad[i], self.pitch_rad[i], self.yaw_rad[i])[(row, column)];
            return Ok((0..rows).map(entry).collect());
        }
        if PRODUCTS.contains(&name) {
            return Ok((0..rows).map(|i| self.product(name, i)).collect());
        }
        self.of_angle(name, runs).ok_or_else(|| FeatureError::Unknown { name: name.to_owned() })
    }

    fn product(&self, name: &str, i: usize) -> f64 {
        let letters: Vec<char> = name.chars().collect();
        let factor = |pair: &[char]| {
            let angle = match pair {
                [_, 'r'] => self.roll_rad[i],
                [_, 'p'] => self.pitch_rad[i],
                _ => self.yaw_rad[i],
            };
            if pair.first() == Some(&'s') { angle.sin() } else { angle.cos() }
        };
        letters.chunks(2).map(factor).product()
    }

    fn of_angle(&self, name: &str, runs: &[Range<usize>]) -> Option<Vec<f64>> {
        let (angle, form) = name.split_once('_')?;
        let angle = self.angles()[ANGLES.iter().position(|a| *a == angle)?];
        let of = |function: fn(f64) -> f64| angle.iter().map(|x| function(*x)).collect::<Vec<f64>>();
        match form {
            "sin" => Some(of(f64::sin)),
            "cos" => Some(of(f64::cos)),
            "sin_fdm" => Some(difference_in_runs(&of(f64::sin), Scheme::Central, runs)),
            "cos_fdm" => Some(difference_in_runs(&of(f64::cos), Scheme::Central, runs)),
            "fdm" => Some(difference_in_runs(&unwrapped(angle), Scheme::Central, runs)),
            _ => None,
        }
    }

    /// The nine direction cosines.
    pub fn direction_cosines(&self) -> Result<Columns, FeatureError> {
        (1..=9).map(|k| format!("dcm_{k}")).map(|name| Ok((name.clone(), self.feature(&name, &[])?))).collect()
    }
}

/// An angle without jumps of whole turns.
fn unwrapped(angle: &[f64]) -> Vec<f64> {
    let mut turns = 0.0;
    let mut before = f64::NAN;
    let mut one = |x: f64| {
        let step = x - before;
        if step.abs() > PI {
            turns -= (step / TAU).round() * TAU;
        }
        before = x;
        x + turns
    };
    angle.iter().map(|x| one(*x)).collect()
}
