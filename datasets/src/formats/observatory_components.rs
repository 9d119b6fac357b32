//! Conversion of the components that an observatory records to north, east, down and total field.

/// Conversion of the recorded components to a vector; the indices are the columns of the components.
#[derive(Clone, Copy, Debug)]
pub(super) enum ComponentConversion {
    /// North, east, down.
    Xyz([usize; 3]),
    /// Horizontal intensity, declination in minutes of arc, down.
    Hdz([usize; 3]),
    /// Horizontal components along and across the direction of the baseline declination, down.
    Hez([usize; 3]),
    /// Declination and inclination in minutes of arc, total intensity.
    Dif([usize; 3]),
}

impl ComponentConversion {
    /// The conversion of columns with these letters; `None` if they do not form a vector.
    pub(super) fn from_letters(letters: &[char]) -> Option<ComponentConversion> {
        let columns = |wanted: [char; 3]| {
            let mut found = wanted.iter().filter_map(|w| letters.iter().position(|l| l == w));
            Some([found.next()?, found.next()?, found.next()?])
        };
        let xyz = columns(['X', 'Y', 'Z']).map(ComponentConversion::Xyz);
        let hdz = || columns(['H', 'D', 'Z']).map(ComponentConversion::Hdz);
        let hez = || columns(['H', 'E', 'Z']).map(ComponentConversion::Hez);
        let dif = || columns(['D', 'I', 'F']).map(ComponentConversion::Dif);
        xyz.or_else(hdz).or_else(hez).or_else(dif)
    }

    /// North, east and down of a line's values; `baseline_rad` is the declination to which horizontal components refer.
    pub(super) fn ned_nt(self, values: &[f64], baseline_rad: f64) -> [f64; 3] {
        let pick = |columns: [usize; 3]| columns.map(|c| values.get(c).copied().unwrap_or(f64::NAN));
        let minutes = |arc: f64| (arc / 60.0).to_radians();
        match self {
            ComponentConversion::Xyz(columns) => pick(columns),
            ComponentConversion::Hdz(columns) => {
                let [h, d, z] = pick(columns);
                let (sin, cos) = (baseline_rad + minutes(d)).sin_cos();
                [h * cos, h * sin, z]
            }
            ComponentConversion::Hez(columns) => {
                let [h, e, z] = pick(columns);
                let (sin, cos) = baseline_rad.sin_cos();
                [h * cos - e * sin, h * sin + e * cos, z]
            }
            ComponentConversion::Dif(columns) => {
                let [d, i, f] = pick(columns);
                let ((sin_d, cos_d), (sin_i, cos_i)) = ((baseline_rad + minutes(d)).sin_cos(), minutes(i).sin_cos());
                [f * cos_i * cos_d, f * cos_i * sin_d, f * sin_i]
            }
        }
    }

    /// The declination of a line's values before the baseline is added, in radians; `None` for a vector without the
    /// component D.
    pub(super) fn own_declination_rad(self, values: &[f64]) -> Option<f64> {
        let (ComponentConversion::Hdz([_, column, _]) | ComponentConversion::Dif([column, ..])) = self else {
            return None;
        };
        values.get(column).map(|arc| (arc / 60.0).to_radians())
    }

    /// Whether north and east depend on a baseline. `relative` states whether the component D, if present, is relative
    /// to the baseline.
    pub(super) fn needs_baseline(self, relative: Option<bool>) -> bool {
        match self {
            ComponentConversion::Xyz(_) => false,
            ComponentConversion::Hez(_) => true,
            // If the type of the data is unknown, D may or may not be relative.
            ComponentConversion::Hdz(_) | ComponentConversion::Dif(_) => relative != Some(false),
        }
    }
}

/// The total field of a line's values. The letters of the columns determine it: S is the measured total field; without
/// S, F is the measured total field. G is the vector's magnitude minus the measured total field or, where the vector is
/// missing, the negated measured total field.
pub(super) fn total_nt(letters: &[char], values: &[f64], ned_nt: &[f64; 3]) -> f64 {
    /// Limit below which G is a negative total field and not a difference, in nT.
    const NO_DIFFERENCE: f64 = -10_000.0;
    let of = |wanted: char| letters.iter().position(|l| *l == wanted).and_then(|c| values.get(c)).copied();
    let vector = ned_nt.iter().map(|x| x * x).sum::<f64>().sqrt();
    let by_difference = |g: f64| if vector.is_nan() && g < NO_DIFFERENCE { -g } else { vector - g };
    of('S').or_else(|| of('F')).or_else(|| of('G').map(by_difference)).unwrap_or(f64::NAN)
}
