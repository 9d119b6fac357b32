//! Tolles-Lawson in vector form, combined with a network.

use learning::network::{FieldCoupling, TERMS_WITHOUT_EDDY, VECTOR_TERMS, VectorFrame};
use schemas::{Fault, Rule, params};

use super::LinearPart;
use crate::fit::samples::FitSamples;

params! {
    /// Vector form of Tolles-Lawson.
    pub struct VectorModelKeys;
    /// Function f(v) that computes the scalar aircraft field from its vector v; see the table of `m3tl`.
    coupling: FieldCoupling, unit "", default FieldCoupling::Magnitude;
    /// For `coupling = "magnitude"`: scale of the Tolles-Lawson terms, equal to `bt_scale_nt` of the stage that
    /// computes them.
    bt_scale_nt: f64, unit "nT", default 50_000.0, rule Rule::Positive;
}

params! {
    /// Curriculum of a training.
    pub struct CurriculumKeys;
    /// Limit for the samples of the first three phases: maximum deviation of the ridge fit's error from the mean error,
    /// in standard deviations of the error.
    curriculum_sigma: f64, unit "1", default 1.0, rule Rule::Positive;
}

/// Magnitudes of the earth's field, with a margin for the aircraft's field, in nT.
const PLAUSIBLE_NT: std::ops::Range<f64> = 15_000.0..90_000.0;

impl VectorModelKeys {
    /// Vector frame (coupling and scales) for a target of this scale, in nT.
    pub fn frame(&self, target_scale_nt: f64) -> VectorFrame {
        VectorFrame { coupling: self.coupling, bt_scale_nt: self.bt_scale_nt, target_scale_nt }
    }

    /// Reason why a key has no effect.
    pub fn unused_key(&self, key: &str) -> Option<Fault> {
        (key == "bt_scale_nt" && self.coupling == FieldCoupling::Projection)
            .then(|| Fault::new("`bt_scale_nt` has no effect without `coupling = \"magnitude\"`"))
    }

    /// Checks the magnitude of the field that the terms give.
    ///
    /// # Errors
    /// Fails if the magnitude is outside the range of the earth's field.
    pub fn check(&self, terms: &[f64], width: usize) -> Result<(), Fault> {
        let field_nt = self.frame(1.0).mean_field_nt(terms, width);
        if self.coupling == FieldCoupling::Projection || PLAUSIBLE_NT.contains(&field_nt) {
            return Ok(());
        }
        let what = format!(
            "the terms give a mean field of {field_nt:.0} nT at the vector magnetometer with `bt_scale_nt` {}",
            self.bt_scale_nt
        );
        let help = "set `bt_scale_nt` as in the stage that computes the terms, or `coupling = \"projection\"`";
        Err(Fault::data(what).of_param("bt_scale_nt").help(help))
    }
}

impl LinearPart {
    /// Positions of the terms of the vector form, in the order of [`VECTOR_TERMS`].
    ///
    /// # Errors
    /// Fails if terms are missing, belong to several vector magnetometers, or are not terms of the vector form.
    pub fn vector_places(&self, samples: &FitSamples) -> Result<Vec<usize>, Fault> {
        let wrong = |what: String| Err(Fault::data(what).of_param("linear"));
        let term = |i: &usize| samples.names.get(*i).and_then(|name| vector_term(name));
        let mut given = samples.places(self.linear.as_ref()).map_err(|f| f.of_param("linear"))?;
        if self.linear.is_some()
            && let Some(other) = given.iter().find(|i| term(i).is_none()).and_then(|i| samples.names.get(*i))
        {
            let fault = Fault::data(format!("`{other}` is not a term of the vector form")).of_param("linear");
            return Err(fault.help("name permanent, induced and eddy terms only; other entries may be `inputs`"));
        }
        given.retain(|i| term(i).is_some());
        let mut places = vec![];
        for name in VECTOR_TERMS {
            let found: Vec<usize> = given.iter().copied().filter(|i| term(i) == Some(name)).collect();
            match found[..] {
                [] => {}
                [place] => places.push(place),
                _ => {
                    let fault = Fault::data("the features hold the terms of several vector magnetometers");
                    return Err(fault
                        .of_param("linear")
                        .help("name the terms of one magnetometer, such as `TL_A_flux_a`, in `linear`"));
                }
            }
        }
        let first: Vec<Option<&str>> = places.iter().map(term).take(TERMS_WITHOUT_EDDY).collect();
        let usual = VECTOR_TERMS.iter().take(TERMS_WITHOUT_EDDY).copied().map(Some);
        if !usual.eq(first) {
            let what = "the vector form requires the permanent terms x, y, z and all six induced terms, xx to zz";
            return wrong(what.to_owned())
                .map_err(|f| f.help("use `a_matrix` with `terms` unset, and `tl` in `features`"));
        }
        if ![TERMS_WITHOUT_EDDY, VECTOR_TERMS.len()].contains(&places.len()) {
            let eddy = places.len() - TERMS_WITHOUT_EDDY;
            return wrong(format!("the vector form requires all nine eddy terms or none, but there are {eddy}"));
        }
        Ok(places)
    }
}

/// Term of the vector form to which a name refers. Names are from `a_matrix` (`xx`) or from `features`
/// (`TL_A_flux_a_xx`).
fn vector_term(name: &str) -> Option<&'static str> {
    let of_features = |term: &str| {
        name.strip_prefix("TL_A_").and_then(|rest| rest.strip_suffix(term)).is_some_and(|rest| rest.ends_with('_'))
    };
    // A name that ends with `xx_dot` does not end with `_x_dot`, so at most one term matches.
    VECTOR_TERMS.into_iter().find(|term| name == *term || of_features(term))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn places(names: &[&str], linear: Option<&[&str]>) -> Result<Vec<usize>, String> {
        let owned = |names: &[&str]| names.iter().map(ToString::to_string).collect::<Vec<String>>();
        let linear = linear.map(owned);
        let part = LinearPart { linear, lambda: 0.0, linear_low_hz: 0.0, linear_high_hz: 0.0 };
        part.vector_places(&FitSamples { names: &owned(names), lines: vec![] }).map_err(|fault| fault.what)
    }

    #[test]
    fn unit_terms_are_found_in_any_order_and_under_both_names() {
        let reversed: Vec<&str> = VECTOR_TERMS.iter().rev().copied().chain(["x_dot", "bias", "cur"]).collect();
        assert_eq!(places(&reversed, None).unwrap(), (0..18).rev().collect::<Vec<_>>());
        let of = |vector: &str| -> Vec<String> {
            VECTOR_TERMS[..9].iter().map(|term| format!("TL_A_{vector}_{term}")).collect()
        };
        let (a, both) = (of("flux_a"), [of("flux_a"), of("flux_x")].concat());
        let names = |all: &[String]| -> Vec<&'static str> {
            all.iter().map(|name| Box::leak(name.clone().into_boxed_str()) as &str).collect()
        };
        assert_eq!(places(&names(&a), None).unwrap(), (0..9).collect::<Vec<_>>());
        assert_eq!(places(&names(&both), Some(&["TL_A_flux_x"])).unwrap(), (9..18).collect::<Vec<_>>());
        assert!(places(&names(&both), None).unwrap_err().contains("several vector magnetometers"));
    }

    #[test]
    fn unit_incomplete_or_foreign_terms_are_rejected() {
        assert!(places(&["x", "y", "z", "xx"], None).unwrap_err().contains("all six induced terms"));
        assert!(
            places(&VECTOR_TERMS[..12], None).unwrap_err().contains("all nine eddy terms or none, but there are 3")
        );
        let more = [&VECTOR_TERMS[..], &["x_dot"]].concat();
        assert_eq!(places(&more, Some(&more)).unwrap_err(), "`x_dot` is not a term of the vector form");
        assert!(places(&["core_x", "core_xx"], None).is_err());
    }

    #[test]
    fn unit_a_scale_of_other_terms_is_rejected() {
        // Terms of a field of 50,000 nT along x, with a scale of 50,000 nT.
        let terms = [1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let keys = |coupling, bt_scale_nt| VectorModelKeys { coupling, bt_scale_nt };
        assert!(keys(FieldCoupling::Magnitude, 50_000.0).check(&terms, 9).is_ok());
        let fault = keys(FieldCoupling::Magnitude, 1.0).check(&terms, 9).unwrap_err();
        assert!(
            fault.what.contains("a mean field of 1 nT") && fault.param.as_deref() == Some("bt_scale_nt"),
            "{fault}"
        );
        assert!(keys(FieldCoupling::Projection, 1.0).check(&terms, 9).is_ok());
        assert!(keys(FieldCoupling::Projection, 1.0).unused_key("bt_scale_nt").is_some());
    }
}
