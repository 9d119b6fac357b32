//! The field of equivalent sources, summed over many sources at many places.

/// Where sources are and how strong they are.
#[derive(Clone, Copy)]
pub(super) struct Sources<'a> {
    pub at: [&'a [f64]; 3],
    pub strength: &'a [f64],
}

/// Adds to `out` at each target the sum of strength · h / r³ over the sources, where `h` is `sign` times how far the
/// target is above the source, and r their distance.
pub(super) fn add_values(targets: [&[f64]; 3], sources: Sources, sign: f64, out: &mut [f64]) {
    pulp::Arch::new().dispatch(
        #[inline(always)]
        || values(targets, sources, sign, out),
    );
}

/// Adds value, east, north and upward derivative of the same sum, with `h` upward.
pub(super) fn add_gradients(targets: [&[f64]; 3], sources: Sources, out: &mut [Vec<f64>; 4]) {
    pulp::Arch::new().dispatch(
        #[inline(always)]
        || gradients(targets, sources, out),
    );
}

#[inline(always)]
fn values([east, north, up]: [&[f64]; 3], sources: Sources, sign: f64, out: &mut [f64]) {
    let [se, sn, su] = sources.at;
    for (((&se, &sn), &su), &q) in se.iter().zip(sn).zip(su).zip(sources.strength) {
        let q = q * sign;
        for (((o, &e), &n), &u) in out.iter_mut().zip(east).zip(north).zip(up) {
            let (de, dn, du) = (e - se, n - sn, u - su);
            let inverse = 1.0 / (de * de + dn * dn + du * du);
            *o += q * du * (inverse * inverse.sqrt());
        }
    }
}

#[inline(always)]
fn gradients([east, north, up]: [&[f64]; 3], sources: Sources, out: &mut [Vec<f64>; 4]) {
    let [se, sn, su] = sources.at;
    let [value, by_east, by_north, by_up] = out;
    for (((&se, &sn), &su), &q) in se.iter().zip(sn).zip(su).zip(sources.strength) {
        let places = east.iter().zip(north).zip(up);
        let sums = value.iter_mut().zip(by_east.iter_mut()).zip(by_north.iter_mut()).zip(by_up.iter_mut());
        for ((((v, ve), vn), vu), ((&e, &n), &u)) in sums.zip(places) {
            let (de, dn, du) = (e - se, n - sn, u - su);
            let inverse = 1.0 / (de * de + dn * dn + du * du);
            let cube = q * (inverse * inverse.sqrt());
            let steep = -3.0 * cube * inverse * du;
            *v += cube * du;
            *ve += steep * de;
            *vn += steep * dn;
            *vu += cube + steep * du;
        }
    }
}
