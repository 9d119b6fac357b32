//! Features computed from the attitude: direction cosines and products of sines and cosines, named as in MagNav.jl.

use crate::earth::attitude::body_to_ned;

/// Named products of sines and cosines of roll, pitch and yaw: `c` and `s` for cosine and sine, `r`, `p` and `y` for
/// the angle.
pub const PRODUCTS: [&str; 20] = [
    "crcy", "cpcy", "crsy", "cpsy", "srcy", "spcy", "srsy", "spsy", "crcpcy", "srcpcy", "crspcy", "srspcy", "crcpsy",
    "srcpsy", "crspsy", "srspsy", "crcp", "srcp", "crsp", "srsp",
];

/// Columns of roll, pitch and yaw, in degrees.
#[derive(Clone, Copy, Debug)]
pub struct AttitudeColumns<'a> {
    /// Right wing down positive.
    pub roll_deg: &'a [f64],
    /// Nose up positive.
    pub pitch_deg: &'a [f64],
    /// Clockwise from true north.
    pub yaw_deg: &'a [f64],
}

impl AttitudeColumns<'_> {
    fn rows(&self) -> usize {
        self.roll_deg.len().min(self.pitch_deg.len()).min(self.yaw_deg.len())
    }

    /// Element of the matrix from north-east-down to the body frame. Elements are counted from 1, column by column, as
    /// in MagNav.jl's `dcm_1` to `dcm_9`. `None` for another number.
    pub fn direction_cosine(&self, number: usize) -> Option<Vec<f64>> {
        let at = number.checked_sub(1).filter(|k| *k < 9)?;
        let one = |i: usize| {
            let [roll, pitch, yaw] = [self.roll_deg[i], self.pitch_deg[i], self.yaw_deg[i]].map(f64::to_radians);
            // Reading the transpose by columns equals reading the matrix by rows.
            body_to_ned(roll, pitch, yaw)[(at / 3, at % 3)]
        };
        Some((0..self.rows()).map(one).collect())
    }

    /// One of [`PRODUCTS`]; `None` for an unknown name.
    pub fn product(&self, name: &str) -> Option<Vec<f64>> {
        PRODUCTS.contains(&name).then(|| (0..self.rows()).map(|i| self.product_at(name, i)).collect())
    }

    fn product_at(&self, name: &str, i: usize) -> f64 {
        let factor = |pair: &[u8]| {
            let angle = match pair.get(1) {
                Some(b'r') => self.roll_deg[i],
                Some(b'p') => self.pitch_deg[i],
                _ => self.yaw_deg[i],
            };
            let (sin, cos) = angle.to_radians().sin_cos();
            if pair.first() == Some(&b's') { sin } else { cos }
        };
        name.as_bytes().chunks(2).map(factor).product()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    const ATTITUDE: AttitudeColumns = AttitudeColumns { roll_deg: &[10.0], pitch_deg: &[-5.0], yaw_deg: &[70.0] };

    #[test]
    fn ref_direction_cosines_equal_magnav() {
        // dcm_1 = C11, dcm_2 = C21, dcm_3 = C31 of nav to body: cos p cos y, -cos r sin y + sin r sin p cos y, ...
        let (r, p, y) = (10f64.to_radians(), (-5f64).to_radians(), 70f64.to_radians());
        let expected = [
            p.cos() * y.cos(),
            -r.cos() * y.sin() + r.sin() * p.sin() * y.cos(),
            r.sin() * y.sin() + r.cos() * p.sin() * y.cos(),
            p.cos() * y.sin(),
            r.cos() * y.cos() + r.sin() * p.sin() * y.sin(),
            -r.sin() * y.cos() + r.cos() * p.sin() * y.sin(),
            -p.sin(),
            r.sin() * p.cos(),
            r.cos() * p.cos(),
        ];
        for (k, expected) in expected.iter().enumerate() {
            assert!((ATTITUDE.direction_cosine(k + 1).unwrap()[0] - expected).abs() < 1e-15, "dcm_{}", k + 1);
        }
        assert!(ATTITUDE.direction_cosine(0).is_none() && ATTITUDE.direction_cosine(10).is_none());
    }

    #[test]
    fn law_products_match_their_names() {
        let (r, p, y) = (10f64.to_radians(), (-5f64).to_radians(), 70f64.to_radians());
        let of = |name| ATTITUDE.product(name).unwrap()[0];
        assert!((of("srspcy") - r.sin() * p.sin() * y.cos()).abs() < 1e-15);
        assert!((of("crcp") - r.cos() * p.cos()).abs() < 1e-15);
        assert!(ATTITUDE.product("crcr").is_none());
    }
}
