//! Components of the crustal field, computed from the component along the core field.

use realfft::num_complex::Complex;

use crate::maps::plane_grid::PlaneGrid;

use super::gain::gain;
use super::spectrum::MapSpectrum;
use super::transform::WavenumberFactor;
use super::{ContinuationError, finite_height, usable_alpha};

/// Sine of 15°. At smaller inclinations, waves across the core field are damped.
const LEAST_SINE: f64 = 0.258_819_045_102_520_76;

/// The anomalous field, in nT.
#[derive(Clone, Debug)]
pub struct AnomalyComponents {
    /// Component towards east.
    pub east: PlaneGrid,
    /// Component towards north.
    pub north: PlaneGrid,
    /// Upward component.
    pub up: PlaneGrid,
    /// Whether waves across the core field were damped because the core field is nearly horizontal. A total-field map
    /// does not contain these waves.
    pub damped: bool,
}

impl MapSpectrum {
    /// Components of the field at `up_m` metres above the map. The map holds the component along `main_field` (`[east,
    /// north, up]`; only its direction matters). At negative heights, α in m² damps the result.
    ///
    /// For a potential of spectrum Φ the components are i k_east Φ, i k_north Φ and −k Φ. The map is their sum along
    /// the unit vector f of the core field: d Φ with d = i (f_east k_east + f_north k_north) − f_up k [Blakely 1996,
    /// section 12.3.1]. |d| is at least k |f_up|; where f_up is below sin 15° the division by d becomes conj(d)/(|d|² +
    /// (sin² 15° − f_up²) k²). The mean and the trend contain no information on direction: they are assumed to be
    /// parallel to the core field.
    ///
    /// MagNav.jl's `vector_fft` uses the same formula, but counts the declination from east, inverts the up component,
    /// and adds the mean to each component.
    ///
    /// # Errors
    /// Fails with [`ContinuationError::Direction`], [`ContinuationError::Height`] or [`ContinuationError::Alpha`].
    pub fn components(
        &self,
        main_field: [f64; 3],
        up_m: f64,
        alpha_m2: f64,
    ) -> Result<AnomalyComponents, ContinuationError> {
        let unit = unit(main_field)?;
        finite_height("a height", up_m)?;
        usable_alpha(alpha_m2)?;
        let floor = (LEAST_SINE * LEAST_SINE - unit[2] * unit[2]).max(0.0);
        let component = |axis: usize| {
            let factor = |east: f64, north: f64| {
                let k = east.hypot(north);
                if k == 0.0 {
                    return Complex::new(unit[axis], 0.0);
                }
                let along = Complex::new(-unit[2] * k, unit[0] * east + unit[1] * north);
                let potential = along.conj() / (along.norm_sqr() + floor * k * k);
                let slope = [Complex::new(0.0, east), Complex::new(0.0, north), Complex::new(-k, 0.0)];
                slope[axis] * potential * gain(k, up_m, alpha_m2)
            };
            self.answer(WavenumberFactor::General(&factor), &self.trend.times(unit[axis]))
        };
        Ok(AnomalyComponents { east: component(0), north: component(1), up: component(2), damped: floor > 0.0 })
    }
}

fn unit(field: [f64; 3]) -> Result<[f64; 3], ContinuationError> {
    let [east, north, up] = field;
    let magnitude = east.hypot(north).hypot(up);
    if magnitude > 0.0 && magnitude.is_finite() {
        Ok(field.map(|component| component / magnitude))
    } else {
        Err(ContinuationError::Direction { east, north, up })
    }
}
