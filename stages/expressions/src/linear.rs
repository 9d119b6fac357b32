//! Expressions that give every row the same weight.

use datafusion::sql::sqlparser::ast::{BinaryOperator, Expr, UnaryOperator, Value};

use crate::{SQL, deep};

/// Whether an expression is a sum of columns with constant factors, and therefore can neither select nor weight rows.
/// The result is false for anything else: products and ratios of columns, functions, conditions, and invalid SQL.
pub fn is_linear(sql: &str) -> bool {
    let read = || {
        let dialect = SQL.config().options().sql_parser.dialect;
        let parsed = SQL.sql_to_expr_with_alias(sql, &dialect).ok()?;
        deep::check(&parsed.expr, deep::PREDICATE).ok()?;
        form(&parsed.expr)
    };
    deep::over(sql, read).is_ok_and(|form| form.is_some())
}

/// Form of a linear expression.
#[derive(Clone, Copy, PartialEq)]
enum LinearForm {
    Constant,
    Columns,
}

fn form(expr: &Expr) -> Option<LinearForm> {
    match expr {
        Expr::Identifier(_) | Expr::CompoundIdentifier(_) => Some(LinearForm::Columns),
        Expr::Value(value) => matches!(value.value, Value::Number(..)).then_some(LinearForm::Constant),
        Expr::Nested(inner) => form(inner),
        Expr::UnaryOp { op: UnaryOperator::Plus | UnaryOperator::Minus, expr } => form(expr),
        Expr::BinaryOp { left, op, right } => match (form(left)?, op, form(right)?) {
            (left, BinaryOperator::Plus | BinaryOperator::Minus, right) => {
                Some(if left == LinearForm::Constant { right } else { left })
            }
            (LinearForm::Constant, BinaryOperator::Multiply, other)
            | (other, BinaryOperator::Multiply | BinaryOperator::Divide, LinearForm::Constant) => Some(other),
            _ => None,
        },
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::is_linear;

    #[test]
    fn unit_only_sums_of_columns_with_constant_factors_are_linear() {
        for sql in ["mag", "0.3048 * alt", "(a - b) / 2 + 3", "-(a + 2 * (b - 1))", "\"A\"", "2014", "a + tt"] {
            assert!(is_linear(sql), "{sql}");
        }
        for sql in [
            "a * b",
            "1 / (tt - 5)",
            "abs(a)",
            "case when tt = 5 then a else 0 end",
            "a * (tt = 5)",
            "a > 1",
            "exp(-tt) * a",
            "a % 2",
            "a / b",
            "cast(tt as int)",
            "nullif(a, b)",
            "(select 1)",
            "a +",
        ] {
            assert!(!is_linear(sql), "{sql}");
        }
    }
}
