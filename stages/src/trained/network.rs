//! A network in a model table: its layout and its prediction.
//!
//! The network N has the inputs z = (x - `input_mean`) / `input_scale`, where x are the unscaled inputs. If the table
//! has components, the inputs of N are `component` z instead of z. The unscaled linear terms are a. The field is the
//! sum of `target_mean` and `target_scale` times
//!
//! | `form` | |
//! |---|---|
//! | `m1` | N(z) |
//! | `m2a` | a . N(z), with one output of N per linear term |
//! | `m2b`, `m2c` | N(z) + a . `linear` |
//! | `m2d` | a . (N(z) + `linear`) |
//! | `m3tl` | f(v) + `b1[1]` |
//! | `m3s` | f(v) + N(z) |
//! | `m3v` | f(v + N(z)) + `constant`, with three outputs of N |
//!
//! The vector v = p + M B/s + E dB/s has the 9 or 18 coefficients `linear`: p = `linear[1]` to `[3]`, the symmetric M
//! with the diagonal `[4]`, `[7]`, `[9]` and half of `[5]`, `[6]`, `[8]` off the diagonal, and E row by row. With s =
//! `bt_scale_nt`, B/s = x (xx + yy + zz) / |x|^2 and dB_j/s = sum of x_i ij_dot over i / |x|^2 follow from the terms,
//! where x are the terms x, y, z. The `coupling` `projection` is f(v) = x . v. The `coupling` `magnitude` is f(v) = (2
//! u . v - k v . v) / (1 + |u - k v|) with u = B/|B| and k = `target_scale` / |B|.
//!
//! N applies, layer by layer, the activation to `w` z + `b`; the last layer has no activation. `w1[3,17]` is the weight
//! of unit 3 of the first layer for its input 17, `b1[3]` the bias. Several members are averaged.

use learning::{
    inputs::{InputScaling, WhitenedComponents},
    network::{ActivationFunction, NetworkForm, NetworkScales, NetworkShape},
};
use numerics::regression::statistics;
use schemas::Fault;

use super::{
    FieldPrediction, NetworkColumns, NetworkLayers, NetworkParts,
    terms::{TermLookup, TermValue, broken, list, member_of, named_list, term},
};

/// Rows per prediction.
const ROWS: usize = 4096;
/// Step of the central difference with respect to a term of a vector form.
const VECTOR_STEP: f64 = 1e-5;

/// The parts of a network with one hidden layer.
pub struct OneLayerNetwork<'a> {
    /// The names of the inputs.
    pub names: &'a [String],
    /// Means and scales of the inputs.
    pub mean: &'a [f64],
    pub scale: &'a [f64],
    pub activation: ActivationFunction,
    /// The weights of the hidden units, unit by unit, and their biases.
    pub w: &'a [f64],
    pub b: &'a [f64],
    /// The weights of the output, and its bias.
    pub v: &'a [f64],
    pub last: f64,
    /// Mean and scale of the target, in nT.
    pub target: (f64, f64),
}

/// Network, or the mean of several networks of one shape.
#[derive(Clone, Debug, PartialEq)]
pub struct NetworkEnsemble {
    columns: NetworkColumns,
    /// Scaling of the inputs.
    scaling: InputScaling,
    shape: NetworkShape,
    /// The parameters of each member.
    members: Vec<Vec<f64>>,
    /// Mean and scale of the target, in nT.
    target: (f64, f64),
}

impl NetworkEnsemble {
    /// Creates the model from its parts. The parameters of each member are in the order of [`NetworkShape::names`].
    ///
    /// # Errors
    /// Fails if the parts do not match.
    pub fn new(
        columns: NetworkColumns,
        scaling: InputScaling,
        shape: NetworkShape,
        members: Vec<Vec<f64>>,
        target: (f64, f64),
    ) -> Result<Self, Fault> {
        let inputs = columns.inputs.len();
        let fits = scaling.mean.len() == inputs
            && scaling.scale.len() == inputs
            && shape.inputs == scaling.width()
            && shape.linear == columns.linear.len()
            && shape.form.is_vector() == columns.frame.is_some()
            && (!shape.form.is_vector() || shape.check().is_ok())
            && !members.is_empty()
            && members.iter().all(|m| m.len() == shape.parameters());
        if !fits {
            return Err(broken("its parts have different sizes".to_owned()));
        }
        Ok(Self { columns, scaling, shape, members, target })
    }

    /// Names of the columns of an input row.
    pub fn columns(&self) -> &[String] {
        &self.columns.all
    }

    /// The names of the inputs.
    pub fn inputs(&self) -> &[String] {
        &self.columns.inputs
    }

    /// The names of the linear terms.
    pub fn linear(&self) -> &[String] {
        &self.columns.linear
    }

    /// See [`LearnedModel::parts`](super::LearnedModel::parts).
    pub fn parts(&self) -> NetworkParts<'_> {
        NetworkParts {
            inputs: self.inputs(),
            scaling: &self.scaling,
            linear: self.linear(),
            frame: self.columns.frame,
            layers: NetworkLayers::Dense(&self.shape),
            members: &self.members,
            scale_nt: self.target.1,
        }
    }

    /// The network as the bytes of an ONNX file. The input `x` has rows of [`NetworkEnsemble::inputs`]. If there are
    /// linear terms, the input `a` has rows of [`NetworkEnsemble::linear`]. Both inputs are unscaled. The output `y` is
    /// the field, in nT.
    ///
    /// # Errors
    /// Fails if the model is the mean of several networks.
    pub fn to_onnx(&self) -> Result<Vec<u8>, Fault> {
        let [member] = &self.members[..] else {
            let what = format!("the model is the mean of {} networks, but an ONNX file holds one", self.members.len());
            return Err(Fault::data(what).help("fit the model with `members = 1`"));
        };
        let (target_mean, target_scale) = self.target;
        let frame = self.columns.frame;
        let scales = NetworkScales { inputs: &self.scaling, linear: None, frame, target_mean, target_scale };
        self.shape.to_onnx(member, &scales).map_err(|e| Fault::bug(e.to_string()))
    }

    /// Splits rows of all columns into the scaled inputs and the linear terms.
    fn split(&self, x: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let (inputs, linear) = self.columns.split(x);
        (self.scaling.apply(&inputs), linear)
    }

    /// See [`LearnedModel::predict`](super::LearnedModel::predict).
    pub fn predict(&self, x: &[f64]) -> FieldPrediction {
        let (mean, scale) = self.target;
        let mut field_nt = vec![];
        let mut sigma_nt = (self.members.len() > 1).then(Vec::new);
        for rows in x.chunks(ROWS * self.columns().len().max(1)) {
            let (z, a) = self.split(rows);
            let a = self.columns.rows(a);
            let all: Vec<Vec<f64>> = self.members.iter().map(|m| self.shape.predict(m, &z, &a)).collect();
            let of_row = |row: usize| all.iter().filter_map(|m| m.get(row)).map(|y| mean + scale * y).collect();
            for row in 0..rows.len() / self.columns().len().max(1) {
                let values: Vec<f64> = of_row(row);
                field_nt.push(statistics::mean(&values).value);
                sigma_nt.iter_mut().for_each(|s| s.push(statistics::std(&values).value));
            }
        }
        FieldPrediction { field_nt, sigma_nt }
    }

    /// Parts of a single network with one hidden layer.
    ///
    /// # Errors
    /// Fails if the model has another number of hidden layers, is the mean of several networks, has a linear part, or
    /// uses principal components.
    pub fn one_layer(&self) -> Result<OneLayerNetwork<'_>, Fault> {
        let fault = |what: &str| {
            let help = "fit `m1` with one hidden layer, and with `whiten` and `members` unset";
            Err(Fault::data(format!("the trained model {what}")).of_param("model").help(help))
        };
        let [hidden] = self.shape.hidden[..] else { return fault("does not have exactly one hidden layer") };
        let [member] = &self.members[..] else { return fault("is the mean of several networks") };
        if self.shape.form != NetworkForm::Plain {
            return fault("has a linear part");
        }
        if self.scaling.components.is_some() {
            return fault("uses principal components");
        }
        let (w, rest) = member.split_at(hidden * self.inputs().len());
        let (b, rest) = rest.split_at(hidden);
        let (v, last) = rest.split_at(hidden);
        Ok(OneLayerNetwork {
            names: self.inputs(),
            mean: &self.scaling.mean,
            scale: &self.scaling.scale,
            activation: self.shape.activation,
            w,
            b,
            v,
            last: last.first().copied().unwrap_or(0.0),
            target: self.target,
        })
    }

    /// See [`LearnedModel::gradient`](super::LearnedModel::gradient). For a column that is both an input and a linear
    /// term, both derivatives are added.
    pub fn gradient(&self, x: &[f64]) -> Vec<f64> {
        let (z, a) = self.split(x);
        let (width, own) = (self.columns().len(), self.inputs().len());
        let rows = self.columns.rows(a.clone());
        let (_, scale) = self.target;
        let share = scale / self.members.len() as f64;
        let mut out = vec![0.0; x.len()];
        for member in &self.members {
            let by_z = self.shape.gradient_of_inputs(member, &z, &rows);
            for (row, by_z) in out.chunks_exact_mut(width).zip(by_z.chunks_exact(self.shape.inputs.max(1))) {
                for (i, by_x) in row.iter_mut().take(own).enumerate() {
                    let by_z: f64 = match &self.scaling.components {
                        Some(c) => by_z.iter().enumerate().map(|(k, d)| d * c.weights[k * own + i]).sum(),
                        None => by_z[i],
                    };
                    *by_x += share * by_z / self.scaling.scale[i];
                }
            }
            // Every form but the vector forms is linear in each linear term.
            let vector = self.columns.frame.is_some();
            let step = if vector { VECTOR_STEP } else { 1.0 };
            let moved = |term: usize, by: f64| {
                let terms = self.linear().len();
                let own = |(i, a): (usize, &f64)| {
                    let by = if i % terms == term { by } else { 0.0 };
                    if vector { a + by } else { by }
                };
                let a: Vec<f64> = a.iter().enumerate().map(own).collect();
                self.shape.predict(member, &z, &self.columns.rows(a))
            };
            for (term, &at) in self.columns.linear_at.iter().enumerate() {
                let (with, without) = (moved(term, step), moved(term, if vector { -step } else { 0.0 }));
                let distance = if vector { 2.0 * step } else { 1.0 };
                for (row, (with, without)) in out.chunks_exact_mut(width).zip(with.iter().zip(&without)) {
                    row[at] += share * (with - without) / distance;
                }
            }
        }
        out
    }

    /// Terms of the model's table.
    pub fn terms(&self) -> Vec<TermValue> {
        let NetworkShape { hidden, activation, form, .. } = &self.shape;
        let hidden: Vec<f64> = hidden.iter().map(|units| *units as f64).collect();
        let mut out =
            vec![term(format!("form {}", form.word()), 1.0), term(format!("activation {}", activation.word()), 1.0)];
        out.extend(list("hidden", &hidden));
        out.extend(named_list("input_mean", self.inputs(), &self.scaling.mean));
        out.extend(list("input_scale", &self.scaling.scale));
        if let Some(components) = &self.scaling.components {
            let own = self.inputs().len().max(1);
            let weights = components.weights.chunks_exact(own).enumerate();
            out.extend(weights.flat_map(|(k, row)| {
                row.iter().enumerate().map(move |(i, w)| term(format!("component[{},{}]", k + 1, i + 1), *w))
            }));
            out.push(term("components", components.count as f64));
            out.push(term("components_explain", components.explained));
        }
        out.extend(self.columns.linear_terms());
        out.push(term("target_mean", self.target.0));
        out.push(term("target_scale", self.target.1));
        out.push(term("members", self.members.len() as f64));
        let names = self.shape.names();
        for (m, member) in self.members.iter().enumerate() {
            out.extend(names.iter().zip(member).map(|(name, value)| term(format!("{}{name}", member_of(m)), *value)));
        }
        out
    }

    /// Reads the network of a table.
    ///
    /// # Errors
    /// Fails if the table is incomplete.
    pub fn read(terms: &TermLookup) -> Result<Self, Fault> {
        let (form, activation): (NetworkForm, _) = (terms.choice("form")?, terms.choice("activation")?);
        let (_, hidden) = terms.list("hidden")?;
        let (inputs, mean) = terms.list("input_mean")?;
        let (_, scale) = terms.list("input_scale")?;
        let columns = NetworkColumns::read(terms, inputs, form.is_vector())?;
        let inputs = &columns.inputs;
        let components = match terms.count("components") {
            Err(_) => None,
            Ok(count) => {
                let at = (1..=count).flat_map(|k| (1..=inputs.len()).map(move |i| format!("component[{k},{i}]")));
                let weights = at.map(|key| terms.value(&key)).collect::<Result<Vec<_>, Fault>>()?;
                Some(WhitenedComponents { count, weights, explained: terms.value("components_explain")? })
            }
        };
        if scale.iter().any(|s| *s <= 0.0) {
            return Err(broken("an input has no scale".to_owned()));
        }
        let scaling = InputScaling { mean, scale, components };
        let hidden = hidden.iter().map(|units| *units as usize).collect();
        let linear = columns.linear.len();
        let shape = NetworkShape { inputs: scaling.width(), linear, hidden, activation, form };
        let names = shape.names();
        let member = |m: usize| {
            let all = names.iter().map(|name| terms.value(&format!("{}{name}", member_of(m))));
            all.collect::<Result<Vec<_>, Fault>>()
        };
        let members = (0..terms.count("members")?).map(member).collect::<Result<Vec<_>, Fault>>()?;
        let target = (terms.value("target_mean")?, terms.value("target_scale")?);
        NetworkEnsemble::new(columns, scaling, shape, members, target)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use learning::network::{FieldCoupling, VECTOR_TERMS, VectorFrame};

    use super::super::LearnedModel;
    use super::*;

    const FORMS: [NetworkForm; 8] = [
        NetworkForm::VectorOnly,
        NetworkForm::VectorScalar,
        NetworkForm::VectorNetwork,
        NetworkForm::Plain,
        NetworkForm::Weights,
        NetworkForm::FixedLinear,
        NetworkForm::TrainedLinear,
        NetworkForm::WeightsAroundFixed,
    ];

    fn network(form: NetworkForm, members: usize) -> NetworkEnsemble {
        let names = |names: &[&str]| names.iter().map(ToString::to_string).collect::<Vec<_>>();
        let linear = match form {
            NetworkForm::Plain => vec![],
            form if form.is_vector() => names(&VECTOR_TERMS),
            _ => names(&["b", "bias"]),
        };
        let frame = form.is_vector().then_some(VectorFrame {
            coupling: FieldCoupling::Magnitude,
            bt_scale_nt: 50_000.0,
            target_scale_nt: 7.0,
        });
        let without = form == NetworkForm::VectorOnly;
        let inputs = if without { vec![] } else { names(&["a", "b"]) };
        let own = |values: [f64; 2]| values[..inputs.len()].to_vec();
        let scaling = InputScaling { mean: own([1.0, -2.0]), scale: own([2.0, 0.5]), components: None };
        let shape = NetworkShape {
            inputs: inputs.len(),
            linear: linear.len(),
            hidden: if without { vec![] } else { vec![3, 2] },
            activation: ActivationFunction::Swish,
            form,
        };
        let members = (0..members).map(|m| shape.initial(m as u64, &vec![0.3; linear.len()])).collect();
        let columns = NetworkColumns::new(inputs, linear, frame);
        NetworkEnsemble::new(columns, scaling, shape, members, (40.0, 7.0)).unwrap()
    }

    /// Values of all columns of a network in each row: the inputs, then the terms of the field at one of three
    /// attitudes.
    fn rows(network: &NetworkEnsemble) -> Vec<f64> {
        let width = network.columns().len();
        if network.columns.frame.is_none() {
            return ROWS.chunks(3).flat_map(|r| r[..width].to_vec()).collect();
        }
        let wave = |i: usize| (1.3 * i as f64).sin();
        let row = |k: usize| {
            let u = [0.6, -0.64, 0.48].map(|u: f64| u + 0.1 * wave(k));
            let field = u.map(|u| 1.1 * u);
            let change = [0.02 * wave(k + 1), -0.03, 0.01 * wave(k + 4)];
            let mut terms = u.to_vec();
            terms.extend((0..3).flat_map(|i| (i..3).map(move |j| u[i] * field[j])));
            terms.extend((0..3).flat_map(|i| change.map(|d| u[i] * d)));
            [&ROWS[3 * k..][..width - 18], &terms].concat()
        };
        (0..3).flat_map(row).collect()
    }

    const ROWS: [f64; 9] = [0.3, -1.0, 1.0, 4.0, 0.5, 1.0, -2.0, 3.0, 1.0];

    #[test]
    fn unit_a_network_is_read_from_its_table_in_any_order() {
        for form in FORMS {
            for members in [1, 3] {
                let network = network(form, members);
                let learned = LearnedModel::Network(network.clone());
                let mut terms = learned.terms();
                terms.sort_by(|a, b| b.name.cmp(&a.name));
                let (names, values): (Vec<String>, Vec<f64>) = terms.into_iter().map(|t| (t.name, t.value)).unzip();
                assert_eq!(LearnedModel::read(&names, &values).unwrap(), Some(learned), "{form:?}");
                for lost in 0..names.len() {
                    let without = |v: &[String]| [&v[..lost], &v[lost + 1..]].concat();
                    let values = [&values[..lost], &values[lost + 1..]].concat();
                    let read = LearnedModel::read(&without(&names), &values);
                    let family = names[lost].starts_with("family");
                    assert!(if family { read.unwrap().is_none() } else { read.is_err() }, "{}", names[lost]);
                }
            }
        }
    }

    #[test]
    fn law_the_gradient_agrees_with_differences_of_the_prediction() {
        for form in FORMS {
            let network = network(form, 2);
            let width = network.columns().len();
            let rows = rows(&network);
            let gradient = network.gradient(&rows);
            for at in 0..rows.len() {
                let moved = |by: f64| {
                    let mut rows = rows.clone();
                    rows[at] += by;
                    network.predict(&rows).field_nt[at / width]
                };
                let slope = (moved(1e-5) - moved(-1e-5)) / 2e-5;
                assert!((slope - gradient[at]).abs() < 1e-6, "{form:?} {at}: {slope} {}", gradient[at]);
            }
        }
    }

    #[test]
    fn unit_members_are_averaged_and_their_spread_is_returned() {
        let rows = &ROWS[..6];
        let rows: Vec<f64> = rows.chunks(3).flat_map(|r| r[..2].to_vec()).collect();
        let network = network(NetworkForm::Plain, 2);
        let one = |m: usize| {
            let alone = NetworkEnsemble { members: vec![network.members[m].clone()], ..network.clone() };
            let made = alone.predict(&rows);
            assert_eq!(made.sigma_nt, None);
            made.field_nt
        };
        let (first, second, both) = (one(0), one(1), network.predict(&rows));
        for i in 0..2 {
            assert!((both.field_nt[i] - 0.5 * (first[i] + second[i])).abs() < 1e-12);
            let sigma = (first[i] - second[i]).abs() / 2.0_f64.sqrt();
            assert!((both.sigma_nt.as_ref().unwrap()[i] - sigma).abs() < 1e-12);
        }
    }
}
