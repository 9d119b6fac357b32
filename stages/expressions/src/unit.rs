//! The unit of an expression.

use datafusion::logical_expr::{BinaryExpr, Expr, Operator};
use schemas::{Fault, TableShape};

/// Unit of an expression, as far as it can be inferred.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ExpressionUnit {
    /// Numbers without columns, which fit any unit.
    Any,
    /// This unit; empty for columns without a unit.
    Of(String),
    /// This unit, times a number that may be a conversion factor.
    Scaled(String),
    /// Unknown.
    Unknown,
}

/// Functions whose value has the unit of their arguments.
const KEEPING: [&str; 10] =
    ["abs", "greatest", "least", "coalesce", "nullif", "nvl", "round", "trunc", "floor", "ceil"];

/// The unit of `expr` over the columns of `shape`.
///
/// # Errors
/// Fails if values of different units are added or compared, or are alternatives of one choice.
pub fn infer_unit(expr: &Expr, shape: &TableShape) -> Result<ExpressionUnit, Fault> {
    let unit_of = |e: &Expr| infer_unit(e, shape);
    let same = |each: &mut dyn Iterator<Item = &Expr>| -> Result<ExpressionUnit, Fault> {
        let mut unit = ExpressionUnit::Any;
        for e in each {
            unit = together(unit, unit_of(e)?, e)?;
        }
        Ok(unit)
    };
    // The units of the operands are checked; the Boolean result has no unit.
    let truth = |each: &mut dyn Iterator<Item = &Expr>| same(each).map(|_| ExpressionUnit::Unknown);
    match expr {
        Expr::Literal(..) => Ok(ExpressionUnit::Any),
        Expr::Column(column) => {
            Ok(shape.get(&column.name).map_or(ExpressionUnit::Unknown, |c| ExpressionUnit::Of(c.unit.clone())))
        }
        Expr::Alias(alias) => unit_of(&alias.expr),
        Expr::Negative(e) => unit_of(e),
        Expr::Cast(cast) => unit_of(&cast.expr),
        Expr::TryCast(cast) => unit_of(&cast.expr),
        Expr::BinaryExpr(BinaryExpr { left, op, right }) => match op {
            Operator::Plus | Operator::Minus | Operator::Modulo => same(&mut [&**left, &**right].into_iter()),
            Operator::Multiply => Ok(product(unit_of(left)?, unit_of(right)?)),
            Operator::Divide => Ok(quotient(unit_of(left)?, unit_of(right)?)),
            Operator::And | Operator::Or => {
                unit_of(left)?;
                unit_of(right)?;
                Ok(ExpressionUnit::Unknown)
            }
            op if op.supports_propagation() => truth(&mut [&**left, &**right].into_iter()),
            _ => {
                unit_of(left)?;
                unit_of(right)?;
                Ok(ExpressionUnit::Unknown)
            }
        },
        Expr::Between(between) => truth(&mut [&*between.expr, &*between.low, &*between.high].into_iter()),
        Expr::InList(list) => truth(&mut std::iter::once(&*list.expr).chain(&list.list)),
        Expr::Not(e)
        | Expr::IsNull(e)
        | Expr::IsNotNull(e)
        | Expr::IsTrue(e)
        | Expr::IsFalse(e)
        | Expr::IsUnknown(e)
        | Expr::IsNotTrue(e)
        | Expr::IsNotFalse(e)
        | Expr::IsNotUnknown(e) => unit_of(e).map(|_| ExpressionUnit::Unknown),
        Expr::Case(case) => {
            let whens = case.when_then_expr.iter().map(|(when, _)| &**when);
            match &case.expr {
                Some(compared) => same(&mut std::iter::once(&**compared).chain(whens))?,
                None => {
                    whens.map(unit_of).collect::<Result<Vec<_>, Fault>>()?;
                    ExpressionUnit::Unknown
                }
            };
            let values = case.when_then_expr.iter().map(|(_, then)| &**then);
            same(&mut values.chain(case.else_expr.as_deref()))
        }
        Expr::ScalarFunction(function) if KEEPING.contains(&function.name()) => same(&mut function.args.iter()),
        Expr::ScalarFunction(function) => {
            function.args.iter().map(unit_of).collect::<Result<Vec<_>, Fault>>()?;
            Ok(ExpressionUnit::Unknown)
        }
        _ => Ok(ExpressionUnit::Unknown),
    }
}

/// Common unit of values that are added or compared. `second` is the expression with the second unit.
fn together(first: ExpressionUnit, other: ExpressionUnit, second: &Expr) -> Result<ExpressionUnit, Fault> {
    Ok(match (first, other) {
        (ExpressionUnit::Any, unit) | (unit, ExpressionUnit::Any) => unit,
        (ExpressionUnit::Of(a), ExpressionUnit::Of(b)) if a == b => ExpressionUnit::Of(a),
        (ExpressionUnit::Of(a), ExpressionUnit::Of(b)) if !a.is_empty() && !b.is_empty() => {
            let what = format!("`{second}` is in {b}, but it is added to or compared with a value in {a}");
            return Err(Fault::new(what).help("convert one of the values by a factor, such as `0.3048 * x`"));
        }
        (ExpressionUnit::Scaled(a) | ExpressionUnit::Of(a), ExpressionUnit::Scaled(b) | ExpressionUnit::Of(b))
            if a == b =>
        {
            ExpressionUnit::Scaled(a)
        }
        (
            ExpressionUnit::Of(_) | ExpressionUnit::Scaled(_) | ExpressionUnit::Unknown,
            ExpressionUnit::Of(_) | ExpressionUnit::Scaled(_) | ExpressionUnit::Unknown,
        ) => ExpressionUnit::Unknown,
    })
}

fn product(a: ExpressionUnit, b: ExpressionUnit) -> ExpressionUnit {
    match (a, b) {
        (ExpressionUnit::Any, ExpressionUnit::Any) => ExpressionUnit::Any,
        (ExpressionUnit::Any, ExpressionUnit::Of(u) | ExpressionUnit::Scaled(u))
        | (ExpressionUnit::Of(u) | ExpressionUnit::Scaled(u), ExpressionUnit::Any) => ExpressionUnit::Scaled(u),
        (ExpressionUnit::Of(one), unit @ ExpressionUnit::Of(_))
        | (unit @ ExpressionUnit::Of(_), ExpressionUnit::Of(one))
            if one == "1" =>
        {
            unit
        }
        (ExpressionUnit::Any | ExpressionUnit::Of(_) | ExpressionUnit::Scaled(_) | ExpressionUnit::Unknown, _) => {
            ExpressionUnit::Unknown
        }
    }
}

fn quotient(a: ExpressionUnit, b: ExpressionUnit) -> ExpressionUnit {
    match (a, b) {
        (ExpressionUnit::Any, ExpressionUnit::Any) => ExpressionUnit::Any,
        (ExpressionUnit::Of(u) | ExpressionUnit::Scaled(u), ExpressionUnit::Any) => ExpressionUnit::Scaled(u),
        (ExpressionUnit::Of(a), ExpressionUnit::Of(b)) if a == b && !a.is_empty() => ExpressionUnit::Of("1".to_owned()),
        (unit @ ExpressionUnit::Of(_), ExpressionUnit::Of(one)) if one == "1" => unit,
        (ExpressionUnit::Any | ExpressionUnit::Of(_) | ExpressionUnit::Scaled(_) | ExpressionUnit::Unknown, _) => {
            ExpressionUnit::Unknown
        }
    }
}
