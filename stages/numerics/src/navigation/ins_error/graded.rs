//! Error sources of an INS from a spec: by grade, individually, or both.

use params::{ChoiceRegistry, Fault, Literal, ParamDoc, ParamReader, Params, SpecEntries, SpecEntry, params};

use super::{InsErrors, InsGrade};

/// Error sources of an INS. The grade gives the unset error sources.
///
/// The grade is resolved when read and is not stored: an INS of a grade equals an INS with the same error sources given
/// individually.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct InsErrorSpec {
    /// The error sources.
    pub sources: InsErrors,
    /// Whether a spec sets an initial position, height or velocity.
    pub start_given: bool,
    /// Whether a spec gives the grade or any error source. If not, a flight can give them.
    pub given: bool,
}

/// Keys of the initial position, height and velocity.
const OF_START: [&str; 3] = ["init_position_sigma_m", "init_altitude_sigma_m", "init_velocity_sigma_mps"];

params! {
    /// Key in addition to the keys of [`InsErrors`].
    struct InsGradeKey;
    /// Grade of the INS. The grade sets the INS keys (`init_*`, `*_sigma*` and `*_tau_s`) that are unset in the spec.
    /// `magnav` sets the defaults shown for these keys. `navigation` is a Honeywell HG9900, `tactical` a Honeywell
    /// HG1700, and `commercial` has micro-mechanical sensors [Lee 2019, Tables 9 and 10]. For these three grades, the
    /// position at alignment is exact (`init_position_sigma_m = 0`).
    ins_grade: Option<InsGrade>, unit "", absent "in `navigate`, the flight's column \
        `ins_grade` if present; otherwise `magnav`";
}

impl From<InsErrors> for InsErrorSpec {
    fn from(sources: InsErrors) -> Self {
        Self { sources, start_given: false, given: true }
    }
}

impl Params for InsErrorSpec {
    fn read(reader: &mut ParamReader, base: Option<&Self>) -> Option<Self> {
        let grade = InsGradeKey::read(reader, None);
        let of_grade = grade.as_ref().and_then(|grade| grade.ins_grade).map(InsGrade::errors);
        let sources = InsErrors::read(reader, of_grade.as_ref().or(base.map(|base| &base.sources)));
        grade?;
        let start_given = OF_START.iter().any(|key| reader.given(key).is_some());
        let of_sources = InsErrors::docs(&ChoiceRegistry::default());
        let given = of_grade.is_some() || of_sources.iter().any(|doc| reader.given(doc.name).is_some());
        sources.map(|sources| Self { sources, start_given, given })
    }

    fn docs(lists: &ChoiceRegistry) -> Vec<ParamDoc> {
        InsGradeKey::docs(lists).into_iter().chain(InsErrors::docs(lists)).collect()
    }

    fn spell(&self, out: &mut Vec<(&'static str, String)>) {
        // The columns of the flight that a stage reads depend on `given` and `start_given`.
        self.sources.spell(out);
    }

    fn check(&self) -> Result<(), Fault> {
        self.sources.check()
    }
}

impl InsErrors {
    /// The error sources as text: the most similar grade, then the error sources that differ from it, as in
    /// `magnav, vrw_sigma = 0.001`.
    pub fn description(&self) -> String {
        let differing = |grade: InsGrade| {
            let (of_grade, own) = (spelt(&grade.errors()), spelt(self));
            own.into_iter().filter(|pair| !of_grade.contains(pair)).collect::<Vec<_>>()
        };
        let all = InsGrade::ALL.into_iter().map(|grade| (grade, differing(grade)));
        let (grade, pairs) = all.min_by_key(|(_, pairs)| pairs.len()).unwrap_or_default();
        let pairs = pairs.into_iter().map(|(key, value)| format!(", {key} = {value}"));
        grade.word().to_owned() + &pairs.collect::<String>()
    }

    /// Reads the text of [`InsErrors::description`]. The grade is optional and defaults to `magnav`.
    ///
    /// # Errors
    /// Fails for an unknown grade or key, or for an invalid value.
    pub fn from_description(text: &str) -> Result<Self, Fault> {
        let mut entries = SpecEntries::new();
        for part in text.split(',').map(str::trim).filter(|part| !part.is_empty()) {
            let (key, value) = match part.split_once('=') {
                None => ("ins_grade", Literal::Text(part.to_owned())),
                Some((key, value)) => {
                    let number = value.trim().parse().map_err(|_| Fault::new(format!("`{part}` is not a number")))?;
                    (key.trim(), Literal::Float(number))
                }
            };
            entries.insert(key.to_owned(), SpecEntry { value, key_at: 0..0, at: 0..0 });
        }
        let lists = ChoiceRegistry::default();
        let (group, faults) = ParamReader::new("INS", &entries, None, &lists).group::<InsErrorSpec>(None);
        match faults.into_iter().next() {
            Some(fault) => Err(fault),
            None => group
                .map(|of| of.sources)
                .ok_or_else(|| Fault::new("the text does not give the error sources of an INS")),
        }
    }
}

fn spelt(errors: &InsErrors) -> Vec<(&'static str, String)> {
    let mut pairs = vec![];
    errors.spell(&mut pairs);
    pairs
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn read(keys: &[(&str, Literal)]) -> Result<InsErrorSpec, Vec<Fault>> {
        let given = |value: &Literal| SpecEntry { value: value.clone(), key_at: 0..0, at: 0..0 };
        let args: SpecEntries = keys.iter().map(|(key, value)| ((*key).to_owned(), given(value))).collect();
        let lists = ChoiceRegistry::default();
        let (group, faults) = ParamReader::new("navigate", &args, None, &lists).group::<InsErrorSpec>(None);
        group.filter(|_| faults.is_empty()).ok_or(faults)
    }

    fn grade(word: &str) -> (&'static str, Literal) {
        ("ins_grade", Literal::Text(word.to_owned()))
    }

    fn spelling(ins: InsErrorSpec) -> Vec<(&'static str, String)> {
        let mut pairs = vec![];
        ins.spell(&mut pairs);
        pairs
    }

    #[test]
    fn unit_the_grade_sets_unset_keys_and_given_keys_override_it() {
        assert_eq!(read(&[]).unwrap().sources, InsErrors::default());
        for of in InsGrade::ALL {
            assert_eq!(read(&[grade(of.word())]).unwrap().sources, of.errors(), "{}", of.word());
        }
        let both = read(&[
            ("acc_sigma_mps2", Literal::Float(0.5)),
            ("init_heading_sigma_deg", Literal::Float(2.0)),
            grade("tactical"),
        ]);
        let expected =
            InsErrors { acc_sigma_mps2: 0.5, init_heading_sigma_deg: Some(2.0), ..InsGrade::Tactical.errors() };
        assert_eq!(both.unwrap().sources, expected);
        // A key that is set to its default counts as given.
        let given = read(&[grade("tactical"), ("init_position_sigma_m", Literal::Float(3.0))]).unwrap();
        assert_eq!(given.sources.init_position_sigma_m, 3.0);
    }

    #[test]
    fn unit_equal_error_sources_have_one_representation() {
        assert_eq!(spelling(read(&[]).unwrap()), spelling(read(&[grade("magnav")]).unwrap()));
        let sigma = ("baro_sigma_m", Literal::Float(1.0));
        assert_eq!(spelling(read(&[sigma]).unwrap()), spelling(read(&[grade("magnav")]).unwrap()));
        let tactical = read(&[grade("tactical")]).unwrap();
        assert_eq!(spelling(tactical), spelling(InsErrorSpec::from(InsGrade::Tactical.errors())));
        assert_ne!(spelling(tactical), spelling(read(&[grade("navigation")]).unwrap()));
    }

    #[test]
    fn unit_error_sources_are_read_back_from_their_description() {
        for grade in InsGrade::ALL {
            assert_eq!(grade.errors().description(), grade.word());
        }
        let drone = InsErrors { vrw_sigma: 0.003_302, init_heading_sigma_deg: Some(2.0), ..InsErrors::default() };
        assert_eq!(drone.description(), "magnav, init_heading_sigma_deg = 2.0, vrw_sigma = 0.003302");
        let near = InsErrors { acc_sigma_mps2: 0.1 + 0.2, ..InsGrade::Tactical.errors() };
        for errors in [drone, near] {
            assert_eq!(InsErrors::from_description(&errors.description()), Ok(errors));
        }
        assert_eq!(InsErrors::from_description(""), Ok(InsErrors::default()));
        let wrong = |text: &str| InsErrors::from_description(text).unwrap_err().what;
        assert!(wrong("tactcal").contains("tactcal") && wrong("vrw = 1").contains("vrw"));
        assert!(wrong("vrw_sigma = -1").contains("0 or above") && wrong("vrw_sigma = x").contains("not a number"));
    }

    #[test]
    fn unit_an_unknown_grade_and_a_wrong_key_are_reported_together() {
        let faults = read(&[grade("tactcal"), ("vrw_sigma", Literal::Float(-1.0))]).unwrap_err();
        assert_eq!(faults.len(), 2, "{faults:?}");
        assert_eq!(faults[0].help.as_deref(), Some("did you mean `tactical`?"));
        assert!(faults[1].what.contains("`vrw_sigma` must be 0 or above"), "{faults:?}");
        let docs = InsErrorSpec::docs(&ChoiceRegistry::default());
        assert_eq!(
            (docs[0].name, docs[0].absent),
            ("ins_grade", Some("in `navigate`, the flight's column `ins_grade` if present; otherwise `magnav`"))
        );
        assert!(["magnav", "navigation", "tactical", "commercial"].iter().all(|word| docs[0].rule.contains(word)));
        assert_eq!(docs.len(), 1 + InsErrors::docs(&ChoiceRegistry::default()).len());
    }
}
