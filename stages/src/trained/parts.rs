//! Parts of a network's prediction: its linear terms, and the vectors of model 3.

use learning::network::{NetworkForm, NetworkShape};

use super::{LearnedModel, NetworkLayers, NetworkParts};

/// Names of the vectors of model 3 in the order of [`PredictionParts::vectors_nt`].
pub const PART_VECTORS: [&str; 12] = [
    "permanent_x",
    "permanent_y",
    "permanent_z",
    "induced_x",
    "induced_y",
    "induced_z",
    "eddy_x",
    "eddy_y",
    "eddy_z",
    "network_x",
    "network_y",
    "network_z",
];

/// Parts of a prediction.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PredictionParts {
    /// Field that the linear terms alone predict in each row, nT. The rest of the prediction comes from the network and
    /// from constants. The linear terms of `m3v` are coupled to the network; this is f(v) without a network.
    pub linear_nt: Vec<f64>,
    /// Vectors of each row in the axes of the terms, nT: permanent, induced and eddy-current field, and the vector of
    /// the network, which is 0 if the network is added to the scalar field. Empty for a model without vectors.
    pub vectors_nt: Vec<[f64; 12]>,
}

impl LearnedModel {
    /// Parts of the prediction for rows of [`LearnedModel::columns`], row-major and finite. The linear part of a model
    /// without linear terms is 0. The parts of several members are averaged.
    pub fn prediction_parts(&self, x: &[f64]) -> PredictionParts {
        let width = self.columns().len().max(1);
        let mut out = PredictionParts { linear_nt: vec![0.0; x.len() / width], vectors_nt: vec![] };
        let Some(parts) = self.parts() else { return out };
        let shape = match parts.layers {
            NetworkLayers::Dense(shape) => shape,
            NetworkLayers::Windowed(shape, _) => &shape.head,
        };
        if shape.linear_coefficients(parts.members.first().map_or(&[], Vec::as_slice)).is_empty() {
            return out;
        }
        let at = parts.linear.iter().filter_map(|name| self.columns().iter().position(|column| column == name));
        let at: Vec<usize> = at.collect();
        let terms: Vec<f64> = x.chunks_exact(width).flat_map(|row| at.iter().map(|&i| row[i])).collect();
        let share = parts.scale_nt / parts.members.len() as f64;
        for member in parts.members {
            let b = shape.linear_coefficients(member);
            let fields = match parts.frame {
                Some(frame) => frame.fields(&terms, b),
                None => terms.chunks_exact(b.len()).map(|row| row.iter().zip(b).map(|(a, b)| a * b).sum()).collect(),
            };
            out.linear_nt.iter_mut().zip(fields).for_each(|(sum, field)| *sum += share * field);
        }
        if parts.frame.is_some() {
            out.vectors_nt = vectors(&parts, shape, x, width, &terms);
        }
        out
    }
}

/// Vectors of model 3 in each row.
fn vectors(parts: &NetworkParts<'_>, shape: &NetworkShape, x: &[f64], width: usize, terms: &[f64]) -> Vec<[f64; 12]> {
    let mut out = vec![[0.0; 12]; x.len() / width];
    let Some(frame) = parts.frame else { return out };
    let share = parts.scale_nt / parts.members.len() as f64;
    let own = parts.inputs.len();
    let inputs: Vec<f64> = x.chunks_exact(width).flat_map(|row| row.iter().take(own).copied()).collect();
    let z = parts.scaling.apply(&inputs);
    let rows = frame.rows(terms, shape.linear);
    for member in parts.members {
        let linear = frame.vectors(terms, shape.linear_coefficients(member));
        let network = match shape.form {
            NetworkForm::VectorNetwork => shape.network_outputs(member, &z, &rows),
            _ => vec![0.0; 3 * out.len()],
        };
        for ((out, linear), network) in out.iter_mut().zip(linear).zip(network.chunks_exact(3)) {
            out.iter_mut().zip(linear.iter().chain(network)).for_each(|(sum, part)| *sum += share * part);
        }
    }
    out
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use learning::{
        inputs::InputScaling,
        network::{ActivationFunction, FieldCoupling, VECTOR_TERMS, VectorFrame},
    };

    use super::{super::NetworkColumns, super::NetworkEnsemble, *};

    /// Mean and scale of the target, nT.
    const TARGET: (f64, f64) = (40.0, 7.0);
    const INPUTS: [&str; 2] = ["a", "b"];

    fn network(
        form: NetworkForm,
        linear: &[&str],
        frame: Option<VectorFrame>,
    ) -> (NetworkShape, Vec<f64>, LearnedModel) {
        let names = |names: &[&str]| names.iter().map(ToString::to_string).collect::<Vec<_>>();
        let scaling = InputScaling { mean: vec![1.0, -2.0], scale: vec![2.0, 0.5], components: None };
        let (inputs, linear, activation) = (names(&INPUTS), names(linear), ActivationFunction::Tanh);
        let shape = NetworkShape { inputs: 2, linear: linear.len(), hidden: vec![3], activation, form };
        let b: Vec<f64> = (0..linear.len()).map(|i| 0.3 + (1.7 * i as f64).sin()).collect();
        let mut member = shape.initial(5, &b);
        if form == NetworkForm::VectorNetwork {
            *member.last_mut().unwrap() = 0.8;
        }
        let columns = NetworkColumns::new(inputs, linear, frame);
        let ensemble = NetworkEnsemble::new(columns, scaling, shape.clone(), vec![member.clone()], TARGET).unwrap();
        (shape, member, LearnedModel::Network(ensemble))
    }

    /// Outputs of the network in a row, computed from the formula of its layers.
    fn outputs(member: &[f64], x: [f64; 2], count: usize) -> Vec<f64> {
        let z = [(x[0] - 1.0) / 2.0, (x[1] + 2.0) / 0.5];
        let hidden: Vec<f64> =
            (0..3).map(|u| (member[2 * u] * z[0] + member[2 * u + 1] * z[1] + member[6 + u]).tanh()).collect();
        let last = &member[9..];
        let of = |o: usize| (0..3).map(|u| last[3 * o + u] * hidden[u]).sum::<f64>() + last[3 * count + o];
        (0..count).map(of).collect()
    }

    fn close(a: f64, b: f64, size: f64) {
        assert!((a - b).abs() <= 4.0 * f64::EPSILON * size, "{a} {b}");
    }

    #[test]
    fn law_the_linear_part_of_model_2_is_the_product_of_terms_and_coefficients() {
        for (form, has_part) in [
            (NetworkForm::Plain, false),
            (NetworkForm::Weights, false),
            (NetworkForm::FixedLinear, true),
            (NetworkForm::TrainedLinear, true),
            (NetworkForm::WeightsAroundFixed, true),
        ] {
            let terms: &[&str] = if form == NetworkForm::Plain { &[] } else { &["b", "bias"] };
            let (shape, member, model) = network(form, terms, None);
            let rows = [[0.3, -1.0, 1.0], [4.0, 0.5, 1.0], [-2.0, 3.0, 1.0]];
            let x: Vec<f64> = rows.iter().flat_map(|row| row[..model.columns().len()].to_vec()).collect();
            let (field, parts) = (model.predict(&x, &[3]).unwrap().field_nt, model.prediction_parts(&x));
            assert!(parts.vectors_nt.is_empty());
            let b = shape.linear_coefficients(&member);
            for (k, row) in rows.iter().enumerate() {
                let linear = if has_part { TARGET.1 * (row[1] * b[0] + row[2] * b[1]) } else { 0.0 };
                close(parts.linear_nt[k], linear, 100.0);
                let n = outputs(
                    &member,
                    [row[0], row[1]],
                    if matches!(form, NetworkForm::Weights | NetworkForm::WeightsAroundFixed) { 2 } else { 1 },
                );
                let n = if n.len() == 2 { row[1] * n[0] + row[2] * n[1] } else { n[0] };
                close(field[k] - parts.linear_nt[k], TARGET.0 + TARGET.1 * n, 1000.0);
            }
        }
    }

    #[test]
    fn law_the_vectors_of_model_3_add_up_to_the_field() {
        let frame =
            VectorFrame { coupling: FieldCoupling::Projection, bt_scale_nt: 50_000.0, target_scale_nt: TARGET.1 };
        for form in [NetworkForm::VectorScalar, NetworkForm::VectorNetwork] {
            let (_, member, model) = network(form, &VECTOR_TERMS, Some(frame));
            let (u, change) = ([0.6, -0.64, 0.48], [0.02, -0.03, 0.01]);
            let field = u.map(|u| 1.1 * u);
            let mut row = vec![0.3, -1.0];
            row.extend(u);
            row.extend((0..3).flat_map(|i| (i..3).map(move |j| u[i] * field[j])));
            row.extend((0..3).flat_map(|i| change.map(|d| u[i] * d)));
            let (found, parts) = (model.predict(&row, &[1]).unwrap().field_nt[0], model.prediction_parts(&row));
            let b = &member[member.len() - 18 - usize::from(form == NetworkForm::VectorNetwork)..][..18];
            let m = [[b[3], b[4] / 2.0, b[5] / 2.0], [b[4] / 2.0, b[6], b[7] / 2.0], [b[5] / 2.0, b[7] / 2.0, b[8]]];
            let count = if form == NetworkForm::VectorNetwork { 3 } else { 1 };
            let n = outputs(&member, [0.3, -1.0], count);
            let vectors = parts.vectors_nt[0];
            for i in 0..3 {
                let eddy: f64 = (0..3).map(|j| b[9 + 3 * i + j] * change[j]).sum();
                let induced: f64 = (0..3).map(|j| m[i][j] * field[j]).sum();
                close(vectors[i], TARGET.1 * b[i], 100.0);
                close(vectors[3 + i], TARGET.1 * induced, 100.0);
                close(vectors[6 + i], TARGET.1 * eddy, 100.0);
                close(vectors[9 + i], if count == 3 { TARGET.1 * n[i] } else { 0.0 }, 100.0);
            }
            let along = |from: usize, to: usize| (from..to).map(|k| u[k % 3] * vectors[k]).sum::<f64>();
            close(parts.linear_nt[0], along(0, 9), 100.0);
            let constant = if count == 3 { member[member.len() - 1] } else { n[0] };
            close(found, TARGET.0 + TARGET.1 * constant + along(0, 12), 1000.0);
        }
    }
}
