//! The field of equivalent sources, summed over many sources at many positions.

/// Positions and strengths of sources.
#[derive(Clone, Copy)]
pub(super) struct PointSources<'a> {
    pub at: [&'a [f64]; 3],
    pub strength: &'a [f64],
}

/// Adds to `out` at each target the sum of strength · h / r³ over the sources. `h` is `sign` times the height of the
/// target above the source, and r is the distance between source and target.
pub(super) fn add_values(targets: [&[f64]; 3], sources: PointSources, sign: f64, out: &mut [f64]) {
    pulp::Arch::new().dispatch(
        #[inline(always)]
        || values(targets, sources, sign, out),
    );
}

/// Adds value and east, north and upward derivative of the same sum, with `h` positive upward.
pub(super) fn add_gradients(targets: [&[f64]; 3], sources: PointSources, out: &mut [Vec<f64>; 4]) {
    pulp::Arch::new().dispatch(
        #[inline(always)]
        || gradients(targets, sources, out),
    );
}

#[inline(always)]
fn values([east, north, up]: [&[f64]; 3], sources: PointSources, sign: f64, out: &mut [f64]) {
    let [se, sn, su] = sources.at;
    for (((&se, &sn), &su), &q) in se.iter().zip(sn).zip(su).zip(sources.strength) {
        let q = q * sign;
        for (((o, &e), &n), &u) in out.iter_mut().zip(east).zip(north).zip(up) {
            let (de, dn, du) = (e - se, n - sn, u - su);
            let inverse = inverse_root(de * de + dn * dn + du * du);
            *o += q * du * (inverse * inverse * inverse);
        }
    }
}

#[inline(always)]
fn gradients([east, north, up]: [&[f64]; 3], sources: PointSources, out: &mut [Vec<f64>; 4]) {
    let [se, sn, su] = sources.at;
    let [value, by_east, by_north, by_up] = out;
    for (((&se, &sn), &su), &q) in se.iter().zip(sn).zip(su).zip(sources.strength) {
        let places = east.iter().zip(north).zip(up);
        let sums = value.iter_mut().zip(by_east.iter_mut()).zip(by_north.iter_mut()).zip(by_up.iter_mut());
        for ((((v, ve), vn), vu), ((&e, &n), &u)) in sums.zip(places) {
            let (de, dn, du) = (e - se, n - sn, u - su);
            let inverse = inverse_root(de * de + dn * dn + du * du);
            let cube = q * (inverse * inverse * inverse);
            let steep = -3.0 * cube * (inverse * inverse) * du;
            *v += cube * du;
            *ve += steep * de;
            *vn += steep * dn;
            *vu += cube + steep * du;
        }
    }
}

/// Computes 1/√x of a positive number with a relative error of 3e-11, by three Newton steps from an estimate with half
/// the exponent. Division and square root take several times as long as these products.
#[inline(always)]
fn inverse_root(x: f64) -> f64 {
    let half = 0.5 * x;
    let mut y = f64::from_bits(0x5fe6_eb50_c7b5_37a9 - (x.to_bits() >> 1));
    for _ in 0..3 {
        y *= 1.5 - half * y * y;
    }
    y
}

#[cfg(test)]
mod tests {
    #[test]
    fn unit_the_inverse_root_is_accurate_to_ten_digits() {
        for k in 0..4000 {
            let x = 1e-3 * 1.01f64.powi(k);
            assert!((super::inverse_root(x) * x.sqrt() - 1.0).abs() < 1e-10);
        }
    }
}
