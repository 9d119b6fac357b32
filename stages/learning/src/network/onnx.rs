//! Export of a dense network as an ONNX model.
//!
//! ONNX is a protocol buffer [onnx.proto of IR version 8, operators of set 13]. This module writes the subset that a
//! dense network needs. A field consists of its number, its kind, and its length if the kind has one.

use crate::inputs::InputScaling;

use super::activation::ActivationFunction;
use super::shape::{NetworkForm, NetworkShape};
use super::vector::VectorFrame;

mod vector_field;

/// Scales of the inputs, the linear terms and the target of a network.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NetworkScales<'a> {
    /// Scaling from columns to inputs.
    pub inputs: &'a InputScaling,
    /// Offsets that are added to the linear terms, and factors by which the sums are multiplied; one offset and one
    /// factor per term. `None` if the terms are unscaled.
    pub linear: Option<(&'a [f64], &'a [f64])>,
    /// For a vector form: coupling of the aircraft field to the scalar reading, and scales.
    pub frame: Option<VectorFrame>,
    /// The mean of the target, in nT.
    pub target_mean: f64,
    /// The scale of the target, in nT.
    pub target_scale: f64,
}

/// Error of the export of a network to ONNX.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum OnnxError {
    /// Sizes do not match.
    #[error("{what}: there are {given} values, but the network requires {expected}")]
    Length {
        /// Quantity of the wrong size.
        what: &'static str,
        /// The given number.
        given: usize,
        /// Required number.
        expected: usize,
    },
    /// A vector form lacks its frame.
    #[error("a network of the model 3 family also requires the coupling of the aircraft field to the scalar")]
    NoFrame,
    /// A parameter or a scale is NaN or infinite.
    #[error("{what} is not finite")]
    NotFinite {
        /// Quantity that is not finite.
        what: &'static str,
    },
}

impl NetworkShape {
    /// The network as the bytes of an ONNX file, in double precision, including the scaling. Input `x` has rows of
    /// unscaled columns. Input `a`, if the form has linear terms, has rows of unscaled linear terms. Output `y` is the
    /// target in nT. The number of rows is not fixed.
    ///
    /// # Errors
    /// Fails for parameters and scales that do not match the network or are not finite.
    pub fn to_onnx(&self, parameters: &[f64], scales: &NetworkScales<'_>) -> Result<Vec<u8>, OnnxError> {
        let expect = |what, given: usize, expected: usize| {
            if given == expected { Ok(()) } else { Err(OnnxError::Length { what, given, expected }) }
        };
        let columns = scales.inputs.mean.len();
        expect("parameters", parameters.len(), self.parameters())?;
        expect("inputs", scales.inputs.width(), self.inputs)?;
        expect("scales of columns", scales.inputs.scale.len(), columns)?;
        let target = [scales.target_mean, scales.target_scale];
        let mut finite = vec![
            ("a parameter", parameters),
            ("the mean of a column", scales.inputs.mean.as_slice()),
            ("the scale of a column", scales.inputs.scale.as_slice()),
            ("the scale of the target", target.as_slice()),
        ];
        if let Some((offset, factor)) = scales.linear {
            expect("offsets of linear terms", offset.len(), self.linear)?;
            expect("factors of linear terms", factor.len(), self.linear)?;
            finite.extend([("the offset of a linear term", offset), ("the factor of a linear term", factor)]);
        }
        if let Some(components) = &scales.inputs.components {
            expect("weights of components", components.weights.len(), components.count * columns)?;
            finite.push(("the weight of a component", components.weights.as_slice()));
        }
        if let Some((what, _)) = finite.iter().find(|(_, values)| !values.iter().all(|x| x.is_finite())) {
            return Err(OnnxError::NotFinite { what });
        }
        let mut graph = OnnxGraph::default();
        let has_inputs = self.inputs > 0;
        let layers = self.layers();
        let mut values = match layers.last() {
            Some(layer) if !has_inputs => graph.constant(&[1], layer.biases(parameters)),
            _ => graph.scaled_inputs(scales.inputs),
        };
        for (number, layer) in layers.iter().enumerate().filter(|_| has_inputs) {
            let weights = graph.constant(&[layer.units, layer.inputs], layer.weights(parameters));
            let biases = graph.constant(&[layer.units], layer.biases(parameters));
            values = graph.dense(&values, &weights, &biases);
            if number + 1 < layers.len() {
                values = graph.activation(self.activation, &values);
            }
        }
        if self.form.is_vector() {
            let frame = scales.frame.as_ref().ok_or(OnnxError::NoFrame)?;
            let b = &parameters[self.linear_start()..];
            let vectors = self.form == NetworkForm::VectorNetwork;
            let field = graph.vector_field(&b[..self.linear], frame, vectors.then_some(values.as_str()));
            let more = if vectors { graph.constant(&[1], &b[self.linear..]) } else { values };
            values = graph.node("Add", &[&field, &more], &[]);
        } else if self.form != NetworkForm::Plain {
            let a = graph.scaled_terms(scales.linear);
            let b = &parameters[self.linear_start()..];
            values = match self.form {
                NetworkForm::Plain
                | NetworkForm::VectorOnly
                | NetworkForm::VectorScalar
                | NetworkForm::VectorNetwork => values,
                NetworkForm::Weights => graph.products(&a, &values),
                NetworkForm::FixedLinear | NetworkForm::TrainedLinear => {
                    let b = graph.constant(&[self.linear, 1], b);
                    let linear = graph.node("MatMul", &[&a, &b], &[]);
                    graph.node("Add", &[&values, &linear], &[])
                }
                NetworkForm::WeightsAroundFixed => {
                    let b = graph.constant(&[self.linear], b);
                    let sum = graph.node("Add", &[&values, &b], &[]);
                    graph.products(&a, &sum)
                }
            };
        }
        let scale = graph.constant(&[1], &[scales.target_scale]);
        let mean = graph.constant(&[1], &[scales.target_mean]);
        let scaled = graph.node("Mul", &[&values, &scale], &[]);
        graph.named_node("Add", &[&scaled, &mean], "y", &[]);
        let mut given = if has_inputs { vec![("x", columns)] } else { vec![] };
        if self.form != NetworkForm::Plain {
            given.push(("a", self.linear));
        }
        Ok(graph.model(&given))
    }
}

/// ONNX graph under construction.
#[derive(Default)]
struct OnnxGraph {
    nodes: ProtobufMessage,
    constants: ProtobufMessage,
    names: usize,
}

impl OnnxGraph {
    fn name(&mut self) -> String {
        self.names += 1;
        format!("v{}", self.names)
    }

    /// Adds a tensor of double precision and returns its name.
    fn constant(&mut self, dimensions: &[usize], values: &[f64]) -> String {
        const DOUBLE: u64 = 11;
        let name = self.name();
        let mut tensor = ProtobufMessage::default();
        dimensions.iter().for_each(|n| tensor.number(1, *n as u64));
        tensor.number(2, DOUBLE);
        tensor.bytes(8, name.as_bytes());
        let raw: Vec<u8> = values.iter().flat_map(|x| x.to_le_bytes()).collect();
        tensor.bytes(9, &raw);
        self.constants.bytes(5, &tensor.0);
        name
    }

    /// Adds a list of whole numbers and returns its name.
    fn axes(&mut self, values: &[i64]) -> String {
        const INT64: u64 = 7;
        let name = self.name();
        let mut tensor = ProtobufMessage::default();
        tensor.number(1, values.len() as u64);
        tensor.number(2, INT64);
        tensor.bytes(8, name.as_bytes());
        let raw: Vec<u8> = values.iter().flat_map(|x| x.to_le_bytes()).collect();
        tensor.bytes(9, &raw);
        self.constants.bytes(5, &tensor.0);
        name
    }

    /// Adds an operation and returns the name of its result.
    fn node(&mut self, operation: &str, inputs: &[&str], integers: &[(&str, u64)]) -> String {
        let name = self.name();
        self.named_node(operation, inputs, &name, integers);
        name
    }

    fn named_node(&mut self, operation: &str, inputs: &[&str], output: &str, integers: &[(&str, u64)]) {
        const INTEGER: u64 = 2;
        let mut node = ProtobufMessage::default();
        inputs.iter().for_each(|input| node.bytes(1, input.as_bytes()));
        node.bytes(2, output.as_bytes());
        node.bytes(4, operation.as_bytes());
        for (name, value) in integers {
            let mut attribute = ProtobufMessage::default();
            attribute.bytes(1, name.as_bytes());
            attribute.number(3, *value);
            attribute.number(20, INTEGER);
            node.bytes(5, &attribute.0);
        }
        self.nodes.bytes(1, &node.0);
    }

    /// Adds the node of x Wᵀ + b, and returns the name of its output.
    fn dense(&mut self, x: &str, weights: &str, biases: &str) -> String {
        self.node("Gemm", &[x, weights, biases], &[("transB", 1)])
    }

    fn activation(&mut self, activation: ActivationFunction, z: &str) -> String {
        match activation {
            ActivationFunction::Swish => {
                let part = self.node("Sigmoid", &[z], &[]);
                self.node("Mul", &[z, &part], &[])
            }
            ActivationFunction::Relu => self.node("Relu", &[z], &[]),
            ActivationFunction::Tanh => self.node("Tanh", &[z], &[]),
            ActivationFunction::Sigmoid => self.node("Sigmoid", &[z], &[]),
        }
    }

    fn scaled_inputs(&mut self, inputs: &InputScaling) -> String {
        let columns = inputs.mean.len();
        let (mean, scale) = (self.constant(&[columns], &inputs.mean), self.constant(&[columns], &inputs.scale));
        let centred = self.node("Sub", &["x", &mean], &[]);
        let scaled = self.node("Div", &[&centred, &scale], &[]);
        let Some(components) = &inputs.components else { return scaled };
        let weights = self.constant(&[components.count, columns], &components.weights);
        let none = self.constant(&[components.count], &vec![0.0; components.count]);
        self.dense(&scaled, &weights, &none)
    }

    fn scaled_terms(&mut self, scales: Option<(&[f64], &[f64])>) -> String {
        let Some((offset, factor)) = scales else { return "a".to_owned() };
        let (offset, factor) = (self.constant(&[offset.len()], offset), self.constant(&[factor.len()], factor));
        let moved = self.node("Add", &["a", &offset], &[]);
        self.node("Mul", &[&moved, &factor], &[])
    }

    /// Adds the row sums of the products and returns their name.
    fn products(&mut self, one: &str, other: &str) -> String {
        let products = self.node("Mul", &[one, other], &[]);
        let axes = self.axes(&[1]);
        self.node("ReduceSum", &[&products, &axes], &[("keepdims", 1)])
    }

    /// The model with these input names and numbers of columns.
    fn model(self, inputs: &[(&str, usize)]) -> Vec<u8> {
        const IR_VERSION: u64 = 8;
        const OPERATORS: u64 = 13;
        let mut graph = self.nodes;
        graph.bytes(2, b"network");
        graph.0.extend(self.constants.0);
        inputs.iter().for_each(|(name, columns)| graph.bytes(11, &rows(name, *columns).0));
        graph.bytes(12, &rows("y", 1).0);
        let mut operators = ProtobufMessage::default();
        operators.bytes(1, b"");
        operators.number(2, OPERATORS);
        let mut model = ProtobufMessage::default();
        model.number(1, IR_VERSION);
        model.bytes(2, b"magline");
        model.bytes(7, &graph.0);
        model.bytes(8, &operators.0);
        model.0
    }
}

/// Describes rows of `columns` columns in double precision.
fn rows(name: &str, columns: usize) -> ProtobufMessage {
    let nested = |number: u64, inner: ProtobufMessage| {
        let mut outer = ProtobufMessage::default();
        outer.bytes(number, &inner.0);
        outer
    };
    let (mut free, mut fixed, mut shape) =
        (ProtobufMessage::default(), ProtobufMessage::default(), ProtobufMessage::default());
    free.bytes(2, b"rows");
    fixed.number(1, columns as u64);
    shape.bytes(1, &free.0);
    shape.bytes(1, &fixed.0);
    let mut tensor = ProtobufMessage::default();
    tensor.number(1, 11);
    tensor.bytes(2, &shape.0);
    let mut value = ProtobufMessage::default();
    value.bytes(1, name.as_bytes());
    value.bytes(2, &nested(1, tensor).0);
    value
}

/// A message of a protocol buffer.
#[derive(Default)]
struct ProtobufMessage(Vec<u8>);

impl ProtobufMessage {
    fn variable(&mut self, mut x: u64) {
        while x >= 0x80 {
            self.0.push((x & 0x7f) as u8 | 0x80);
            x >>= 7;
        }
        self.0.push(x as u8);
    }

    /// Appends a field with a whole number.
    fn number(&mut self, field: u64, x: u64) {
        self.variable(field << 3);
        self.variable(x);
    }

    /// Appends a field of bytes, text or a message.
    fn bytes(&mut self, field: u64, x: &[u8]) {
        self.variable(field << 3 | 2);
        self.variable(x.len() as u64);
        self.0.extend_from_slice(x);
    }
}
