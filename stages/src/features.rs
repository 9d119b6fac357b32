//! Computes the features of compensation models.

mod samples;

use std::cell::OnceCell;

use numerics::{
    compensation::{
        attitude_terms::PRODUCTS,
        model_terms::{AnomalySlopeModel, ExtendedTermGroup, core_term_names},
        tolles_lawson::TermSelection,
    },
    signal::difference::DifferenceScheme,
};
use samples::FeatureSamples;
use schemas::{
    Column, ColumnType, Fault, LineInput, LineOutput, LineStage, RateDependence, RateLaw, Rule, Stage, StageSchema,
    Table, TableShape, stage,
};

use crate::{
    columns::{floats, list, no_truth, shape, vector_axes},
    core_field::PositionSource,
};

stage! {
    /// Appends the list column `features`. Its entries are computed from other columns, as defined in the theses under
    /// 'Source'.
    /// | feature | definition |
    /// |---|---|
    /// | any column | the column itself |
    /// | `COLUMN_dot`, `COLUMN_dot4` | central and fourth difference of the column per sample |
    /// | `COLUMN_lag_N` | value of the column N samples earlier |
    /// | `mag_2_3_uc` | `mag_2_uc` minus `mag_3_uc`, for any two magnetometers |
    /// | `lpf_COLUMN` | the column after a low-pass filter at 0.2 Hz |
    /// | `dcm`, `dcm_1` to `dcm_9` | direction cosines of the rotation from north-east-down to body, column by column |
    /// | `crcy`, ... `srsp` | products of the cosines (c) and sines (s) of roll (r), pitch (p) and yaw (y) |
    /// | `TL_A_flux_a` | Tolles-Lawson terms of a vector magnetometer |
    /// | `ETL_COLUMN` | terms `COLUMN_1` to `COLUMN_7` of the extended Tolles-Lawson model, as set by `groups` |
    /// | `core_flux_a` | 21 terms of the core-field model; requires `igrf_x`, `igrf_y`, `igrf_z` of `core_field` |
    /// | `slope`, `slope_quadratic` | easting and northing (km); `slope_quadratic` adds their squares and product |
    ///
    /// The core-field model uses the computed core field instead of the measured field in its induced and eddy terms
    /// (van der Meer 2025). Three names denote sets of features: `down_selected` (Gnadt 2022, Table C.1), `small_1` and
    /// `small_2` (Gnadt 2022, section 4.9). The small sets use the magnetometer `mag` and the vector magnetometer
    /// `vector`.
    ///
    /// Differences and lags are per sample. The column's metadata list them (`per_sample`), and hold the sample rate
    /// (`rate_hz`) if a `resample` stage set it. A stage that applies a model at another rate converts the differences
    /// to that rate, and fails if the model has lags. A column of the table, such as one made by `derivative`, is used
    /// unchanged at any rate.
    ///
    /// Differences, lags and filters stay within a run of samples without gaps. A feature is NaN where it cannot be
    /// computed, and `fit` omits that row. Truth columns and features with missing inputs are rejected.
    ///
    /// Source: Gnadt 2022, section 4.8 and appendix C; van der Meer 2025, sections 2.2.2 and 2.3; Lee 2019, appendix B.
    /// Names follow MagNav.jl.
    Features = "features", version 3, grain Line, inputs [input: Lines],
    example r#"
[[stages]]
name     = "features"
stage    = "features"
input    = "resample"
features = ["mag_4_uc", "mag_4_uc_dot", "TL_A_flux_a"]
"#;
    /// Features, in the order of the list.
    features: Vec<String>, unit "";
    /// Groups of Tolles-Lawson terms in the features `TL_A_...`.
    terms: Option<Vec<String>>, unit "", absent "permanent, induced and eddy terms; for the sets \
        `down_selected`, `small_1` and `small_2`: permanent, induced and derivative terms";
    /// Scale of the induced, eddy and core-field terms.
    bt_scale_nt: f64, unit "nT", default 50_000.0, rule Rule::Positive;
    /// Vector magnetometer of the small sets. The inputs of `ETL_...` are projected on the direction of the field that
    /// it measures.
    vector: Option<String>, unit "", absent "`ETL_...` and the small sets are rejected";
    /// Scalar magnetometer of the small sets.
    mag: Option<String>, unit "nT", absent "the small sets are rejected";
    /// Groups of the extended model: 1 for raw inputs, 2 for inputs projected on the direction of the field, 3 for
    /// projected rates of change.
    groups: Vec<usize>, unit "", default [1usize, 2, 3];
    /// Latitude and longitude, in degrees, of the origin of `slope`.
    origin: Option<Vec<f64>>, unit "deg", absent "the line's first sample";
    /// Position used by `slope`.
    position: PositionSource, unit "", default PositionSource::Ins;
    /// Allows truth columns as features.
    allow_truth: bool, unit "", default false;
}

/// Corner frequency, in Hz, and order of `lpf_...`, as in MagNav.jl.
const LOW_PASS: (f64, usize) = (0.2, 4);
const ATTITUDE: [&str; 3] = ["ins_roll", "ins_pitch", "ins_yaw"];
const CORE: [&str; 3] = ["igrf_x", "igrf_y", "igrf_z"];
/// Names of sets of features.
const SETS: [&str; 3] = ["down_selected", "small_1", "small_2"];
/// Largest lag, in samples.
const MOST_LAG: usize = 1000;

/// One feature, parsed.
#[derive(Clone, Debug, PartialEq)]
enum FeatureDefinition {
    Plain(String),
    Difference(String, DifferenceScheme),
    Lag(String, usize),
    /// Name, and the two columns.
    Between(String, [String; 2]),
    LowPass(String),
    Dcm(usize),
    Product(String),
    TollesLawson(String),
    Extended(String, ExtendedTermGroup),
    Core(String),
    Slope(AnomalySlopeModel),
}

/// Splits the name of a difference: `mag_2_3_uc` becomes `mag_2_uc` and `mag_3_uc`.
fn gradient(name: &str) -> Option<(String, String)> {
    let (middle, kind) = name.strip_prefix("mag_")?.rsplit_once('_')?;
    let (one, other) = middle.split_once('_')?;
    matches!(kind, "uc" | "c").then(|| (format!("mag_{one}_{kind}"), format!("mag_{other}_{kind}")))
}

impl FeatureDefinition {
    /// Columns that the feature reads.
    fn reads(&self, stage: &Features) -> Vec<String> {
        let own = |names: [&str; 3]| names.map(str::to_owned).to_vec();
        match self {
            FeatureDefinition::Plain(c)
            | FeatureDefinition::Difference(c, _)
            | FeatureDefinition::Lag(c, _)
            | FeatureDefinition::LowPass(c) => vec![c.clone()],
            FeatureDefinition::Between(_, pair) => pair.to_vec(),
            FeatureDefinition::Dcm(_) | FeatureDefinition::Product(_) => own(ATTITUDE),
            FeatureDefinition::TollesLawson(v) => vector_axes(v).to_vec(),
            FeatureDefinition::Extended(c, group) => {
                let vector = stage.vector.as_deref().filter(|_| *group != ExtendedTermGroup::Raw).map(vector_axes);
                std::iter::once(c.clone()).chain(vector.into_iter().flatten()).collect()
            }
            FeatureDefinition::Core(v) => vector_axes(v).into_iter().chain(own(CORE)).collect(),
            FeatureDefinition::Slope(_) => stage.place().map(str::to_owned).to_vec(),
        }
    }

    /// Dependence of a feature on the sample rate; `None` if there is none.
    fn law(&self, name: &str) -> Option<RateLaw> {
        match self {
            FeatureDefinition::Difference(_, DifferenceScheme::Fourth) => Some(RateLaw::Difference(4)),
            FeatureDefinition::Difference(..) | FeatureDefinition::Extended(_, ExtendedTermGroup::ProjectedChange) => {
                Some(RateLaw::Difference(1))
            }
            FeatureDefinition::Lag(..) => Some(RateLaw::Lag),
            FeatureDefinition::TollesLawson(_) | FeatureDefinition::Core(_) => {
                name.ends_with("_dot").then_some(RateLaw::Difference(1))
            }
            // A recorded column has the same meaning at any rate, even if its name has the ending of a derivative.
            FeatureDefinition::Plain(_)
            | FeatureDefinition::Between(..)
            | FeatureDefinition::LowPass(_)
            | FeatureDefinition::Dcm(_)
            | FeatureDefinition::Product(_) => None,
            FeatureDefinition::Extended(_, ExtendedTermGroup::Raw | ExtendedTermGroup::Projected)
            | FeatureDefinition::Slope(_) => None,
        }
    }

    fn names(&self, terms: &TermSelection) -> Vec<String> {
        match self {
            FeatureDefinition::Plain(c) => vec![c.clone()],
            FeatureDefinition::Difference(c, DifferenceScheme::Fourth) => vec![format!("{c}_dot4")],
            FeatureDefinition::Difference(c, _) => vec![format!("{c}_dot")],
            FeatureDefinition::Lag(c, n) => vec![format!("{c}_lag_{n}")],
            FeatureDefinition::Between(name, _) => vec![name.clone()],
            FeatureDefinition::LowPass(c) => vec![format!("lpf_{c}")],
            FeatureDefinition::Dcm(k) => vec![format!("dcm_{k}")],
            FeatureDefinition::Product(name) => vec![name.clone()],
            FeatureDefinition::TollesLawson(v) => terms.names().iter().map(|t| format!("TL_A_{v}_{t}")).collect(),
            FeatureDefinition::Extended(c, group) => group.suffixes().iter().map(|k| format!("{c}_{k}")).collect(),
            FeatureDefinition::Core(_) => core_term_names(),
            FeatureDefinition::Slope(slope) => slope.names().iter().map(|n| (*n).to_owned()).collect(),
        }
    }
}

impl Features {
    fn place(&self) -> [&'static str; 2] {
        let [lat, lon, _] = self.position.columns();
        [lat, lon]
    }

    fn terms(&self) -> Result<TermSelection, Fault> {
        let changes = if self.features.iter().any(|f| SETS.contains(&f.as_str())) { "derivative" } else { "eddy" };
        let usual = || ["permanent", "induced", changes].map(str::to_owned).to_vec();
        TermSelection::new(&self.terms.clone().unwrap_or_else(usual))
            .map_err(|e| Fault::new(e.to_string()).of_param("terms"))
    }

    /// Features of a set; any other name is returned unchanged.
    fn spelt(&self, name: &str) -> Result<Vec<String>, Fault> {
        let need = |given: &Option<String>, param: &'static str| {
            let missing =
                || Fault::new(format!("the set `{name}` requires `{param}`; set `{param}`")).of_param("features");
            given.clone().ok_or_else(missing)
        };
        match name {
            "down_selected" => Ok(down_selected()),
            "small_1" | "small_2" => {
                let (mag, vector) = (need(&self.mag, "mag")?, need(&self.vector, "vector")?);
                let more: Vec<&str> = match name {
                    "small_1" => CURRENTS.into_iter().chain(["dcm_1", "dcm_4"]).collect(),
                    _ => vec![],
                };
                let own = [mag.clone(), format!("{mag}_dot"), format!("{mag}_dot4"), format!("TL_A_{vector}")];
                Ok(more.iter().map(|n| (*n).to_owned()).chain(own).collect())
            }
            _ => Ok(vec![name.to_owned()]),
        }
    }

    /// All features, parsed with the available columns.
    fn recipes(&self, has: &dyn Fn(&str) -> bool) -> Result<Vec<FeatureDefinition>, Vec<Fault>> {
        let (mut out, mut faults) = (vec![], vec![]);
        for given in &self.features {
            match self.spelt(given) {
                Ok(names) => names.iter().for_each(|name| out.extend(self.recipe(name, has))),
                Err(fault) => faults.push(fault),
            }
        }
        if self.features.is_empty() {
            faults.push(Fault::new("`features` is empty; add at least one feature").of_param("features"));
        }
        if faults.is_empty() { Ok(out) } else { Err(faults) }
    }

    fn recipe(&self, name: &str, has: &dyn Fn(&str) -> bool) -> Vec<FeatureDefinition> {
        let plain = || vec![FeatureDefinition::Plain(name.to_owned())];
        // An existing column of that name takes precedence, so a recorded value is not computed again.
        if has(name) {
            return plain();
        }
        if name == "dcm" {
            return (1..=9).map(FeatureDefinition::Dcm).collect();
        }
        if let Some(k) = name.strip_prefix("dcm_").and_then(|k| k.parse().ok()).filter(|k| (1..=9).contains(k)) {
            return vec![FeatureDefinition::Dcm(k)];
        }
        if PRODUCTS.contains(&name) {
            return vec![FeatureDefinition::Product(name.to_owned())];
        }
        match name {
            "slope" => return vec![FeatureDefinition::Slope(AnomalySlopeModel::Planar)],
            "slope_quadratic" => return vec![FeatureDefinition::Slope(AnomalySlopeModel::Quadratic)],
            _ => {}
        }
        if let Some(vector) = name.strip_prefix("TL_A_") {
            return vec![FeatureDefinition::TollesLawson(vector.to_owned())];
        }
        if let Some(column) = name.strip_prefix("ETL_") {
            return self.extended(column);
        }
        if let Some(vector) = name.strip_prefix("core_") {
            return vec![FeatureDefinition::Core(vector.to_owned())];
        }
        if let Some(column) = name.strip_prefix("lpf_") {
            return vec![FeatureDefinition::LowPass(column.to_owned())];
        }
        if let Some(column) = name.strip_suffix("_dot4") {
            return vec![FeatureDefinition::Difference(column.to_owned(), DifferenceScheme::Fourth)];
        }
        if let Some(column) = name.strip_suffix("_dot") {
            return vec![FeatureDefinition::Difference(column.to_owned(), DifferenceScheme::Central)];
        }
        if let Some((column, n)) = name.rsplit_once("_lag_")
            && let Some(n) = n.parse().ok().filter(|n| (1..=MOST_LAG).contains(n))
        {
            return vec![FeatureDefinition::Lag(column.to_owned(), n)];
        }
        match gradient(name).filter(|(a, b)| has(a) && has(b)) {
            Some((a, b)) => vec![FeatureDefinition::Between(name.to_owned(), [a, b])],
            None => plain(),
        }
    }

    fn extended(&self, column: &str) -> Vec<FeatureDefinition> {
        let groups = [ExtendedTermGroup::Raw, ExtendedTermGroup::Projected, ExtendedTermGroup::ProjectedChange];
        let wanted = groups.into_iter().enumerate().filter(|(i, _)| self.groups.contains(&(i + 1)));
        wanted.map(|(_, group)| FeatureDefinition::Extended(column.to_owned(), group)).collect()
    }

    /// First fault of a feature.
    fn check(&self, recipe: &FeatureDefinition, shape: &TableShape) -> Option<Fault> {
        if matches!(recipe, FeatureDefinition::Extended(_, g) if *g != ExtendedTermGroup::Raw) && self.vector.is_none()
        {
            let what = "`ETL_...` projects its inputs on the direction of a vector magnetometer; set `vector`";
            return Some(Fault::new(what).of_param("features"));
        }
        recipe.reads(self).iter().find_map(|name| {
            let found = shape.need(name).and_then(|c| match c.column_type {
                ColumnType::Float => no_truth(c, "features", self.allow_truth),
                _ => Err(Fault::new(format!("column `{name}` does not hold numbers"))),
            });
            let help = matches!(recipe, FeatureDefinition::Core(_)) && CORE.contains(&name.as_str());
            let fault = found.err()?;
            let fault = if help { fault.help("add a `core_field` stage before this one") } else { fault };
            Some(fault.of_param("features"))
        })
    }
}

impl Stage for Features {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        let recipes = self.recipes(&|name| shape.get(name).is_some())?;
        let mut faults: Vec<Fault> = recipes.iter().filter_map(|r| self.check(r, shape)).collect();
        faults.dedup_by(|a, b| a.what == b.what);
        if let Some(k) = self.groups.iter().find(|k| !(1..=3).contains(*k)) {
            faults.push(Fault::new(format!("there is no group {k}; the groups are 1, 2 and 3")).of_param("groups"));
        }
        if self.origin.as_ref().is_some_and(|o| o.len() != 2) {
            faults.push(Fault::new("`origin` must be a latitude and a longitude, in degrees").of_param("origin"));
        }
        let terms = self.terms();
        faults.extend(terms.as_ref().err().cloned());
        let names: Vec<String> = terms.iter().flat_map(|t| recipes.iter().flat_map(|r| r.names(t))).collect();
        for (i, name) in names.iter().enumerate() {
            if names.iter().take(i).any(|n| n == name) {
                faults.push(Fault::new(format!("duplicate feature `{name}`")).of_param("features"));
            }
        }
        if !faults.is_empty() {
            return Err(faults);
        }
        let mut reads = vec!["tt".to_owned()];
        for name in recipes.iter().flat_map(|r| r.reads(self)) {
            if !reads.contains(&name) {
                reads.push(name);
            }
        }
        let laws =
            terms.iter().flat_map(|t| recipes.iter().flat_map(|r| r.names(t).into_iter().map(move |n| (r.law(&n), n))));
        let entries: Vec<(String, RateLaw)> = laws.filter_map(|(law, name)| Some((name, law?))).collect();
        let rate_hz = shape.rate_hz.filter(|_| !entries.is_empty());
        let column = Column::list("features", "", "features of a compensation model", names).from(0, &reads);
        let column = Column { sampling: RateDependence { rate_hz, entries }, ..column };
        Ok(StageSchema::append(vec![column], &reads))
    }
}

impl LineStage for Features {
    type Prepared = ();

    fn run(&self, line: &LineInput, (): &()) -> LineOutput {
        let batch = &line.inputs[0];
        let recipes = self.recipes(&|name| batch.column_by_name(name).is_some());
        let recipes = recipes.map_err(|f| f.into_iter().next().unwrap_or_else(|| Fault::data("no feature")))?;
        let (tt, terms, direction) = (floats(batch, "tt")?, self.terms()?, OnceCell::new());
        let source = FeatureSamples { stage: self, batch, tt, terms, direction };
        let mut columns: Vec<Vec<f64>> = vec![];
        for recipe in &recipes {
            columns.extend(source.columns(recipe)?);
        }
        let rows = source.tt.len();
        let mut matrix = Vec::with_capacity(rows * columns.len());
        for i in 0..rows {
            matrix.extend(columns.iter().map(|c| c[i]));
        }
        Ok(vec![list(matrix, columns.len())?])
    }
}

/// The reduced set of currents and one voltage. [Gnadt 2022, section 4.9]
const CURRENTS: [&str; 9] =
    ["cur_com_1", "cur_ac_hi", "cur_ac_lo", "cur_flap", "cur_strb", "cur_heat", "cur_acpwr", "cur_outpwr", "vol_bat_1"];

/// The 77 features of Gnadt 2022, Table C.1, with twelve terms of each vector magnetometer.
fn down_selected() -> Vec<String> {
    let mags = ["2", "3", "4", "5"];
    let pairs =
        mags.iter().enumerate().flat_map(|(i, a)| mags.iter().skip(i + 1).map(move |b| format!("mag_{a}_{b}_uc")));
    let place = ["igrf", "ins_lat", "ins_lon", "ins_alt"];
    let before = ["dcm", "baro"].iter().chain(&CURRENTS).chain(&place).map(|n| (*n).to_owned());
    let plain = mags.iter().map(|m| format!("mag_{m}_uc"));
    let changes = mags.iter().flat_map(|m| [format!("mag_{m}_uc_dot"), format!("mag_{m}_uc_dot4")]);
    let vectors = ["a", "c", "d"].iter().map(|v| format!("TL_A_flux_{v}"));
    before.chain(plain).chain(changes).chain(pairs).chain(vectors).collect()
}

#[cfg(test)]
#[path = "features/tests.rs"]
mod tests;
