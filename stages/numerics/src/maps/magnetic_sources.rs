//! Magnetic fields in closed form: the dipole and the uniformly magnetised rectangular prism.
//!
//! All vectors are in a right-handed frame of easting, northing and up in metres, the frame of
//! [`PlaneGrid`](crate::maps::plane_grid::PlaneGrid) with heights. A vector is `[east, north, up]`, so the core field
//! of the northern hemisphere has a negative third component. Fields are in nT.
//!
//! A dipole of moment m (A m²) has the field B = µ0/4π (3 (m·r̂) r̂ − m)/r³ [Blakely 1996, eq. 4.14]. A prism of
//! magnetisation M (A/m) has the field B = µ0/4π U·M. U contains the second derivatives of ∫1/r dv, which are sums over
//! the eight corners of −atan(y z/(x r)) and ln(z + r) [Bhattacharyya 1964; Nagy, Papp and Benedek 2000, J. Geodesy
//! 74], the logarithm in the form of Fukushima [2020, Geophys. J. Int. 222], which avoids cancellation in line with an
//! edge. Inside the prism µ0 M is added, so that B is valid inside and outside.

/// µ0/4π in nT m/A: the field of a moment of 1 A m² at 1 m; the measured value is larger by 5e-10.
const NT_M_PER_A: f64 = 100.0;

/// A point or a vector as easting, northing and up.
pub type EastNorthUp = [f64; 3];

/// A magnetic dipole.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dipole {
    /// Position, in metres.
    pub at_m: EastNorthUp,
    /// Moment, in A m².
    pub moment_am2: EastNorthUp,
}

impl Dipole {
    /// Field in nT at a point; NaN at the position of the dipole.
    pub fn field_nt(&self, point_m: EastNorthUp) -> EastNorthUp {
        let r = difference(point_m, self.at_m);
        let square = dot(r, r);
        let along = 3.0 * dot(self.moment_am2, r) / square;
        let scale = NT_M_PER_A / (square * square.sqrt());
        std::array::from_fn(|i| scale * (along * r[i] - self.moment_am2[i]))
    }
}

/// A rectangular prism with edges along easting, northing and up, uniformly magnetised.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prism {
    /// Western, southern and lower bounds, in metres.
    pub low_m: EastNorthUp,
    /// Eastern, northern and upper bounds, in metres, each above the corresponding lower bound.
    pub high_m: EastNorthUp,
    /// Magnetisation, in A/m.
    pub magnetisation_apm: EastNorthUp,
}

/// Position of a point relative to one pair of faces of a prism.
#[derive(Clone, Copy, PartialEq)]
enum FaceSide {
    Outside,
    Face,
    Between,
}

impl Prism {
    /// Field B in nT at a point outside or inside the prism; on a face, the value just outside.
    ///
    /// On an edge or a corner the field has no limit: the components are NaN there.
    pub fn field_nt(&self, point_m: EastNorthUp) -> EastNorthUp {
        let places: [FaceSide; 3] = std::array::from_fn(|i| self.place(point_m, i));
        let faces = places.iter().filter(|place| **place == FaceSide::Face).count();
        if places.contains(&FaceSide::Outside) {
            return self.without_jump(point_m);
        }
        match faces {
            0 => self.with_own_magnetisation(point_m, [4.0; 3]),
            1 => self.with_own_magnetisation(point_m, places.map(|p| if p == FaceSide::Face { 2.0 } else { 0.0 })),
            _ => [f64::NAN; 3],
        }
    }

    /// The moment, in A m².
    pub fn moment_am2(&self) -> EastNorthUp {
        let volume: f64 = (0..3).map(|i| self.high_m[i] - self.low_m[i]).product();
        self.magnetisation_apm.map(|m| m * volume)
    }

    /// The middle, in metres.
    pub fn middle_m(&self) -> EastNorthUp {
        std::array::from_fn(|i| 0.5 * (self.low_m[i] + self.high_m[i]))
    }

    fn place(&self, point_m: EastNorthUp, i: usize) -> FaceSide {
        let (low, high) = (self.low_m[i], self.high_m[i]);
        if point_m[i] == low || point_m[i] == high {
            FaceSide::Face
        } else if low < point_m[i] && point_m[i] < high {
            FaceSide::Between
        } else {
            FaceSide::Outside
        }
    }

    /// Sums over the corners plus `times` π M; `times` is 4 inside the prism and 2 on a face. On a face the sums give
    /// the mean of both sides; the term 2 π M gives the normal component its value just outside.
    fn with_own_magnetisation(&self, point_m: EastNorthUp, times: [f64; 3]) -> EastNorthUp {
        let field = self.without_jump(point_m);
        let pi = std::f64::consts::PI;
        std::array::from_fn(|i| field[i] + NT_M_PER_A * times[i] * pi * self.magnetisation_apm[i])
    }

    /// µ0/4π U·M from the eight corners.
    fn without_jump(&self, point_m: EastNorthUp) -> EastNorthUp {
        let bounds = [difference(self.low_m, point_m), difference(self.high_m, point_m)];
        let mut field = [0.0; 3];
        for corner in 0..8_usize {
            let r: EastNorthUp = std::array::from_fn(|i| bounds[corner >> i & 1][i]);
            let sign = if corner.count_ones() % 2 == 1 { NT_M_PER_A } else { -NT_M_PER_A };
            let part = times_symmetric(corner_tensor(r), self.magnetisation_apm);
            (0..3).for_each(|i| field[i] += sign * part[i]);
        }
        field
    }
}

/// The kernels `[xx, yy, zz, xy, xz, yz]` of one corner.
fn corner_tensor([x, y, z]: EastNorthUp) -> [f64; 6] {
    let r = x.hypot(y).hypot(z);
    let angle = |along: f64, a: f64, b: f64| if along == 0.0 { 0.0 } else { -(a * b / (along * r)).atan() };
    let logarithm = |along: f64, a: f64, b: f64| {
        if along > 0.0 {
            (along + r).ln()
        } else if a == 0.0 && b == 0.0 {
            -(-2.0 * along).ln() // the infinite part is the same at both ends of the edge and cancels
        } else {
            ((a * a + b * b) / (r - along)).ln()
        }
    };
    [angle(x, y, z), angle(y, x, z), angle(z, x, y), logarithm(z, x, y), logarithm(y, x, z), logarithm(x, y, z)]
}

fn times_symmetric([xx, yy, zz, xy, xz, yz]: [f64; 6], m: EastNorthUp) -> EastNorthUp {
    let [x, y, z] = m;
    // A component of magnetisation that is zero does not contribute, even where the kernel is infinite.
    let sum = |parts: [(f64, f64); 3]| parts.iter().filter(|(_, m)| *m != 0.0).map(|(k, m)| k * m).sum();
    [sum([(xx, x), (xy, y), (xz, z)]), sum([(xy, x), (yy, y), (yz, z)]), sum([(xz, x), (yz, y), (zz, z)])]
}

/// A magnetised body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MagneticBody {
    /// A dipole.
    Dipole(Dipole),
    /// A prism.
    Prism(Prism),
}

impl MagneticBody {
    /// The field in nT at a point.
    pub fn field_nt(&self, point_m: EastNorthUp) -> EastNorthUp {
        match self {
            Self::Dipole(dipole) => dipole.field_nt(point_m),
            Self::Prism(prism) => prism.field_nt(point_m),
        }
    }
}

/// The field of all sources together in nT at a point, summed in the order of the sources.
pub fn field_of_all_nt(sources: &[MagneticBody], point_m: EastNorthUp) -> EastNorthUp {
    sources.iter().fold([0.0; 3], |sum, source| {
        let field = source.field_nt(point_m);
        std::array::from_fn(|i| sum[i] + field[i])
    })
}

/// The unit vector of a field with an inclination (downwards from the horizontal) and a declination (from north
/// towards east), both in degrees.
pub fn direction(inclination_deg: f64, declination_deg: f64) -> EastNorthUp {
    let (sin_i, cos_i) = inclination_deg.to_radians().sin_cos();
    let (sin_d, cos_d) = declination_deg.to_radians().sin_cos();
    [cos_i * sin_d, cos_i * cos_d, -sin_i]
}

/// Total-field anomaly in nT: the component of a field along the core field, of which only the direction matters.
///
/// The component is harmonic and, to first order, equal to the magnetometer reading. [Blakely 1996, eq. 8.20]
pub fn total_field_anomaly_nt(field_nt: EastNorthUp, main_field: EastNorthUp) -> f64 {
    dot(field_nt, main_field) / dot(main_field, main_field).sqrt()
}

/// Change in the magnitude of the core field (nT) caused by a field in nT: the magnetometer reading.
pub fn magnitude_change_nt(field_nt: EastNorthUp, main_field_nt: EastNorthUp) -> f64 {
    let both: EastNorthUp = std::array::from_fn(|i| field_nt[i] + main_field_nt[i]);
    let magnitudes = dot(both, both).sqrt() + dot(main_field_nt, main_field_nt).sqrt();
    if magnitudes == 0.0 {
        return 0.0;
    }
    // The difference of the magnitudes without cancellation.
    (2.0 * dot(field_nt, main_field_nt) + dot(field_nt, field_nt)) / magnitudes
}

fn dot(a: EastNorthUp, b: EastNorthUp) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn difference(a: EastNorthUp, b: EastNorthUp) -> EastNorthUp {
    std::array::from_fn(|i| a[i] - b[i])
}

#[cfg(test)]
mod tests;
