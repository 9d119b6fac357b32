//! Tolles-Lawson in vector form: the linear part of the models m3 of MagNav.jl.
//!
//! B is the field at the vector magnetometer and dB its difference per sample, both in the body frame. The coefficients
//! give the aircraft field as a vector,
//!
//! ```text
//! v = p + M B/s + E dB/s + n
//! ```
//!
//! with the permanent field p, the symmetric induced matrix M, the eddy-current matrix E, s the scale of the terms, and
//! n the outputs of a network (m3v) or 0. M has the coefficients xx, yy, zz on its diagonal and half of xy, xz, yz on
//! both sides of it; E has the nine eddy coefficients row by row. The scalar field of the aircraft is
//!
//! ```text
//! magnitude:   f = |B| − |B − v| = (2 u·v − κ v·v) / (1 + |u − κ v|),  u = B/|B|, κ = 1/|B|
//! projection:  f = u·v
//! ```
//!
//! The second form of the magnitude has no difference of large numbers. Its limit for κ = 0 is the projection. Since
//! u·M B/s and u·E dB/s are sums of coefficients times Tolles-Lawson terms, the projection is linear Tolles-Lawson. The
//! projection exceeds the magnitude by |v⊥|²/2|B| in second order, with v⊥ the part of v across B. The gradient with
//! respect to v is the direction of the field without the aircraft, w = (u − κ v)/|u − κ v|, or u for the projection.
//! The gradients with respect to p, M, E and n follow as w, w Bᵀ/s, w dBᵀ/s and w.
//!
//! The vectors B/s and dB/s are computed from the terms: with the terms x_i = B_i/Bt, x_i x_j Bt/s and x_i dB_j/s,
//! Bt/s is (xx + yy + zz)/(x² + y² + z²), and dB_j/s is Σ x_i (ij_dot)/(x² + y² + z²).
//!
//! Source: MagNav.jl 1.3.3, `get_TL_aircraft_vec` and `nn_comp_3_fwd`. MagNav.jl uses the projection for the targets c
//! and d, and |B − v| for the targets a and b, which it compares with the earth field.

use params::choice;

use super::shape::NetworkForm;

/// Names of the terms in order: permanent, induced, eddy.
pub const VECTOR_TERMS: [&str; 18] = [
    "x", "y", "z", "xx", "xy", "xz", "yy", "yz", "zz", "xx_dot", "xy_dot", "xz_dot", "yx_dot", "yy_dot", "yz_dot",
    "zx_dot", "zy_dot", "zz_dot",
];

/// Number of permanent and induced terms.
pub const TERMS_WITHOUT_EDDY: usize = 9;

/// Values of a row: u (3), κ (1), B/s (3), dB/s (3).
pub(super) const ROW: usize = 10;

/// Rows and columns of the induced coefficients xx, xy, xz, yy, yz, zz.
const INDUCED: [(usize, usize); 6] = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];

choice! {
    /// Scalar field of the aircraft, computed from its vector v and the field B at the vector magnetometer.
    #[derive(Default)]
    pub enum FieldCoupling {
        /// \|B\| - \|B - v\|: exact if the vector magnetometer measures the aircraft field of the scalar magnetometer.
        #[default]
        Magnitude = "magnitude",
        /// v . B / \|B\|: the first-order approximation of linear Tolles-Lawson.
        Projection = "projection",
    }
}

/// Conversion of Tolles-Lawson terms to the rows that the vector forms of [`NetworkForm`] require.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VectorFrame {
    /// Scalar field of the aircraft.
    pub coupling: FieldCoupling,
    /// Scale s of the induced and eddy terms, in nT.
    pub bt_scale_nt: f64,
    /// Scale of the target, in nT.
    pub target_scale_nt: f64,
}

impl VectorFrame {
    /// Rows for the samples of [`NetworkSamples`](super::NetworkSamples) from rows of terms in the order of
    /// [`VECTOR_TERMS`], row-major. `width` is 18, or 9 without eddy terms. The values of a row without a field are
    /// NaN.
    pub fn rows(&self, terms: &[f64], width: usize) -> Vec<f64> {
        let mut out = Vec::with_capacity(terms.len() / width.max(1) * ROW);
        for terms in terms.chunks_exact(width.max(TERMS_WITHOUT_EDDY)) {
            let x = [terms[0], terms[1], terms[2]];
            let square = dot(&x, &x);
            let per_cosine = (terms[3] + terms[6] + terms[8]) / square;
            let field = x.map(|x| x * per_cosine);
            let magnitude = dot(&field, &field).sqrt();
            let change = |j: usize| match terms.get(TERMS_WITHOUT_EDDY..) {
                Some(eddy) if !eddy.is_empty() => (0..3).map(|i| x[i] * eddy[3 * i + j]).sum::<f64>() / square,
                _ => 0.0,
            };
            let (u, per_field) = match self.coupling {
                FieldCoupling::Projection => (x, 0.0),
                FieldCoupling::Magnitude => {
                    (field.map(|h| h / magnitude), self.target_scale_nt / (self.bt_scale_nt * magnitude))
                }
            };
            out.extend(u);
            out.push(per_field);
            out.extend(field);
            out.extend([change(0), change(1), change(2)]);
        }
        out
    }

    /// Scalar fields without a network, for rows of terms and the coefficients `b`. The fields and v are in the scale
    /// of the target.
    pub fn fields(&self, terms: &[f64], b: &[f64]) -> Vec<f64> {
        tolles_lawson_fields(&self.rows(terms, b.len()), b)
    }

    /// Vectors of the permanent, induced and eddy-current field, for rows of terms and the coefficients `b`: nine
    /// numbers per row in the axes of the terms, in the scale of the target. Their sum is the vector v without a
    /// network.
    pub fn vectors(&self, terms: &[f64], b: &[f64]) -> Vec<[f64; 9]> {
        let coefficients = VectorCoefficients::new(b);
        let times = |m: &[[f64; 3]; 3], x: [f64; 3]| m.map(|row| dot(&row, &x));
        let of = |row: &[f64; ROW]| {
            let [.., hx, hy, hz, dx, dy, dz] = *row;
            let induced = times(&coefficients.induced, [hx, hy, hz]);
            let eddy = times(&coefficients.eddy, [dx, dy, dz]);
            let [p, m, e] = [coefficients.permanent, induced, eddy];
            [p[0], p[1], p[2], m[0], m[1], m[2], e[0], e[1], e[2]]
        };
        self.rows(terms, b.len()).as_chunks::<ROW>().0.iter().map(of).collect()
    }

    /// Mean magnitude of the field of some rows of terms, in nT. NaN without rows.
    pub fn mean_field_nt(&self, terms: &[f64], width: usize) -> f64 {
        let projection = Self { coupling: FieldCoupling::Projection, ..*self };
        let rows = projection.rows(terms, width);
        let sum: f64 = rows.chunks_exact(ROW).map(|row| dot(&row[4..7], &row[4..7]).sqrt()).sum();
        self.bt_scale_nt * sum / (rows.len() / ROW) as f64
    }
}

/// Coefficients as a vector and matrices, in the scale of the target.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct VectorCoefficients {
    permanent: [f64; 3],
    induced: [[f64; 3]; 3],
    eddy: [[f64; 3]; 3],
}

impl VectorCoefficients {
    /// Coefficients in the order of [`VECTOR_TERMS`].
    pub fn new(b: &[f64]) -> Self {
        let mut out = Self::default();
        out.permanent.copy_from_slice(&b[..3]);
        for ((i, j), b) in INDUCED.into_iter().zip(&b[3..TERMS_WITHOUT_EDDY]) {
            out.induced[i][j] += 0.5 * b;
            out.induced[j][i] += 0.5 * b;
        }
        for (row, b) in out.eddy.iter_mut().zip(b[TERMS_WITHOUT_EDDY..].chunks_exact(3)) {
            row.copy_from_slice(b);
        }
        out
    }

    /// Permanent field.
    pub fn permanent(&self) -> [f64; 3] {
        self.permanent
    }

    /// Symmetric matrix of the induced field.
    pub fn induced(&self) -> [[f64; 3]; 3] {
        self.induced
    }

    /// Matrix of the eddy-current field.
    pub fn eddy(&self) -> [[f64; 3]; 3] {
        self.eddy
    }

    /// Scalar field of a row, and its gradient with respect to the vector field. `more` is added to the vector field.
    #[inline(always)]
    pub fn field(&self, row: &[f64; ROW], more: [f64; 3]) -> (f64, [f64; 3]) {
        let [ux, uy, uz, per_field, hx, hy, hz, dx, dy, dz] = *row;
        let mut v = more;
        for (i, v) in v.iter_mut().enumerate() {
            let (m, e) = (&self.induced[i], &self.eddy[i]);
            *v += self.permanent[i] + (m[0] * hx + m[1] * hy + m[2] * hz) + (e[0] * dx + e[1] * dy + e[2] * dz);
        }
        let along = ux * v[0] + uy * v[1] + uz * v[2];
        if per_field == 0.0 {
            return (along, [ux, uy, uz]);
        }
        let w = [ux - per_field * v[0], uy - per_field * v[1], uz - per_field * v[2]];
        let length = dot(&w, &w).sqrt();
        let field = (2.0 * along - per_field * dot(&v, &v)) / (1.0 + length);
        (field, w.map(|w| w / length))
    }
}

/// Sums of gradients over rows.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct VectorGradient {
    permanent: [f64; 3],
    induced: [[f64; 3]; 3],
    eddy: [[f64; 3]; 3],
}

impl VectorGradient {
    /// Adds the gradient of a row: `by` is the derivative with respect to the scalar field, `direction` the gradient of
    /// the scalar field.
    #[inline(always)]
    pub fn add(&mut self, row: &[f64; ROW], direction: [f64; 3], by: f64) {
        let (field, change) = ([row[4], row[5], row[6]], [row[7], row[8], row[9]]);
        for (i, direction) in direction.into_iter().enumerate() {
            let by = by * direction;
            self.permanent[i] += by;
            for j in 0..3 {
                self.induced[i][j] += by * field[j];
                self.eddy[i][j] += by * change[j];
            }
        }
    }

    /// Writes the gradient with respect to the coefficients, in the order of [`VECTOR_TERMS`].
    pub fn write(&self, gradient: &mut [f64]) {
        let induced = INDUCED.map(|(i, j)| 0.5 * (self.induced[i][j] + self.induced[j][i]));
        let all = self.permanent.iter().chain(&induced).chain(self.eddy.as_flattened());
        gradient.iter_mut().zip(all).for_each(|(to, value)| *to = *value);
    }
}

/// Scalar fields of rows with these coefficients and no network, in the scale of the target.
pub(super) fn tolles_lawson_fields(rows: &[f64], b: &[f64]) -> Vec<f64> {
    let coefficients = VectorCoefficients::new(b);
    rows.as_chunks::<ROW>().0.iter().map(|row| coefficients.field(row, [0.0; 3]).0).collect()
}

impl NetworkForm {
    /// Whether the linear part is Tolles-Lawson in vector form.
    pub fn is_vector(self) -> bool {
        matches!(self, Self::VectorOnly | Self::VectorScalar | Self::VectorNetwork)
    }
}

#[inline(always)]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
