//! Tolles-Lawson in vector form, as operations on the input `a` of unscaled terms.

use super::{OnnxGraph, VectorFrame};
use crate::network::vector::{FieldCoupling, TERMS_WITHOUT_EDDY, VectorCoefficients};

/// Positions of xx, yy and zz.
const DIAGONAL: [usize; 3] = [3, 6, 8];

impl OnnxGraph {
    /// Adds the scalar field of the aircraft in the scale of the target, for rows of the terms `a`, and returns its
    /// name. `network` is the name of the vector field of a network.
    pub(super) fn vector_field(&mut self, b: &[f64], frame: &VectorFrame, network: Option<&str>) -> String {
        let (terms, coefficients) = (b.len(), VectorCoefficients::new(b));
        let cosines = self.selection(terms, 3, |row, column| row == column);
        let square = self.products(&cosines, &cosines);
        let trace = self.selection(terms, 1, |row, _| DIAGONAL.contains(&row));
        let per_cosine = self.node("Div", &[&trace, &square], &[]);
        let field = self.node("Mul", &[&cosines, &per_cosine], &[]);
        let induced = self.constant(&[3, 3], coefficients.induced().as_flattened());
        let permanent = self.constant(&[3], &coefficients.permanent());
        let induced = self.node("MatMul", &[&field, &induced], &[]);
        let mut vector = self.node("Add", &[&induced, &permanent], &[]);
        if terms > TERMS_WITHOUT_EDDY {
            let eddy = self.selection(terms, 9, |row, column| row == TERMS_WITHOUT_EDDY + column);
            let repeat = self.matrix(3, 9, |row, column| f64::from(u8::from(column / 3 == row)));
            let repeated = self.node("MatMul", &[&cosines, &repeat], &[]);
            let products = self.node("Mul", &[&repeated, &eddy], &[]);
            let sum = self.matrix(9, 3, |row, column| f64::from(u8::from(row % 3 == column)));
            let sums = self.node("MatMul", &[&products, &sum], &[]);
            let change = self.node("Div", &[&sums, &square], &[]);
            let transposed = coefficients.eddy();
            let matrix = self.matrix(3, 3, |row, column| transposed[column][row]);
            let eddy = self.node("MatMul", &[&change, &matrix], &[]);
            vector = self.node("Add", &[&vector, &eddy], &[]);
        }
        if let Some(network) = network {
            vector = self.node("Add", &[&vector, network], &[]);
        }
        match frame.coupling {
            FieldCoupling::Projection => self.products(&cosines, &vector),
            FieldCoupling::Magnitude => {
                let square = self.products(&field, &field);
                let magnitude = self.node("Sqrt", &[&square], &[]);
                let direction = self.node("Div", &[&field, &magnitude], &[]);
                let scale = self.constant(&[1], &[frame.target_scale_nt / frame.bt_scale_nt]);
                let per_field = self.node("Div", &[&scale, &magnitude], &[]);
                let relative = self.node("Mul", &[&vector, &per_field], &[]);
                let rest = self.node("Sub", &[&direction, &relative], &[]);
                let square = self.products(&rest, &rest);
                let length = self.node("Sqrt", &[&square], &[]);
                let (one, two) = (self.constant(&[1], &[1.0]), self.constant(&[1], &[2.0]));
                let along = self.products(&direction, &vector);
                let twice = self.node("Mul", &[&along, &two], &[]);
                let second = self.products(&relative, &vector);
                let difference = self.node("Sub", &[&twice, &second], &[]);
                let sum = self.node("Add", &[&length, &one], &[]);
                self.node("Div", &[&difference, &sum], &[])
            }
        }
    }

    /// Adds sums of selected columns of `a`, and returns their name.
    fn selection(&mut self, terms: usize, columns: usize, is: impl Fn(usize, usize) -> bool) -> String {
        let matrix = self.matrix(terms, columns, |row, column| f64::from(u8::from(is(row, column))));
        self.node("MatMul", &["a", &matrix], &[])
    }

    fn matrix(&mut self, rows: usize, columns: usize, value: impl Fn(usize, usize) -> f64) -> String {
        let values: Vec<f64> = (0..rows * columns).map(|i| value(i / columns, i % columns)).collect();
        self.constant(&[rows, columns], &values)
    }
}
