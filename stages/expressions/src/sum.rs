//! The terms of an expression as a sum.

use datafusion::{
    common::ScalarValue,
    logical_expr::{BinaryExpr, Expr, Operator},
};

/// Columns of `expr` as a sum, each with 1 if it is added, -1 if it is subtracted, and 0 for any other use. Conditions
/// of a `case` do not count. The expression must not be nested deeply.
pub fn signed_terms(expr: &Expr) -> Vec<(i8, String)> {
    let mut terms = vec![];
    gather(expr, 1, &mut terms);
    terms
}

fn gather(expr: &Expr, sign: i8, terms: &mut Vec<(i8, String)>) {
    match expr {
        Expr::Column(column) => terms.push((sign, column.name.clone())),
        Expr::Alias(alias) => gather(&alias.expr, sign, terms),
        Expr::Cast(cast) => gather(&cast.expr, sign, terms),
        Expr::TryCast(cast) => gather(&cast.expr, sign, terms),
        Expr::Negative(inner) => gather(inner, -sign, terms),
        Expr::BinaryExpr(BinaryExpr { left, op, right }) => {
            let (left_sign, right_sign) = match (op, number(left), number(right)) {
                (Operator::Plus, ..) => (sign, sign),
                (Operator::Minus, ..) => (sign, -sign),
                (Operator::Multiply, Some(factor), _) => (0, signed(sign, factor)),
                (Operator::Multiply | Operator::Divide, _, Some(factor)) => (signed(sign, factor), 0),
                _ => (0, 0),
            };
            gather(left, left_sign, terms);
            gather(right, right_sign, terms);
        }
        Expr::Case(case) => {
            let values = case.when_then_expr.iter().map(|(_, then)| then).chain(&case.else_expr);
            values.for_each(|value| gather(value, sign, terms));
        }
        Expr::ScalarFunction(function) => {
            // These functions return one of their arguments unchanged; all others return a new value.
            let keeps = matches!(function.name(), "coalesce" | "nvl" | "greatest" | "least" | "nullif");
            function.args.iter().for_each(|value| gather(value, if keeps { sign } else { 0 }, terms));
        }
        other => terms.extend(other.column_refs().into_iter().map(|column| (0, column.name.clone()))),
    }
}

fn signed(sign: i8, factor: f64) -> i8 {
    if factor < 0.0 { -sign } else { sign }
}

/// The value of a constant expression.
fn number(expr: &Expr) -> Option<f64> {
    match expr {
        Expr::Literal(ScalarValue::Float64(Some(x)), _) => Some(*x),
        Expr::Literal(ScalarValue::Int64(Some(x)), _) => Some(*x as f64),
        Expr::Negative(inner) => number(inner).map(|x| -x),
        _ => None,
    }
}
