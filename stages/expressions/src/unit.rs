//! The unit of an expression.

use datafusion::logical_expr::{BinaryExpr, Expr, Operator};
use schemas::{Fault, Shape};

/// Unit of an expression, as far as it can be inferred.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Unit {
    /// Numbers alone, which have any.
    Any,
    /// This one; empty for columns that have none.
    Of(String),
    /// This one, times a number that may have been meant to convert it.
    Scaled(String),
    /// It does not follow.
    Unknown,
}

/// Functions whose value has the unit of their arguments.
const KEEPING: [&str; 10] =
    ["abs", "greatest", "least", "coalesce", "nullif", "nvl", "round", "trunc", "floor", "ceil"];

/// The unit of `expr` over the columns of `shape`.
///
/// # Errors
/// Fails where values of different units are added, compared or chosen from.
pub fn of(expr: &Expr, shape: &Shape) -> Result<Unit, Fault> {
    let of = |e: &Expr| of(e, shape);
    let same = |each: &mut dyn Iterator<Item = &Expr>| -> Result<Unit, Fault> {
        let mut unit = Unit::Any;
        for e in each {
            unit = together(unit, of(e)?, e)?;
        }
        Ok(unit)
    };
    // The operands have units to check; the answer has none.
    let truth = |each: &mut dyn Iterator<Item = &Expr>| same(each).map(|_| Unit::Unknown);
    match expr {
        Expr::Literal(..) => Ok(Unit::Any),
        Expr::Column(column) => Ok(shape.get(&column.name).map_or(Unit::Unknown, |c| Unit::Of(c.unit.clone()))),
        Expr::Alias(alias) => of(&alias.expr),
        Expr::Negative(e) => of(e),
        Expr::Cast(cast) => of(&cast.expr),
        Expr::TryCast(cast) => of(&cast.expr),
        Expr::BinaryExpr(BinaryExpr { left, op, right }) => match op {
            Operator::Plus | Operator::Minus | Operator::Modulo => same(&mut [&**left, &**right].into_iter()),
            Operator::Multiply => Ok(product(of(left)?, of(right)?)),
            Operator::Divide => Ok(quotient(of(left)?, of(right)?)),
            Operator::And | Operator::Or => {
                of(left)?;
                of(right)?;
                Ok(Unit::Unknown)
            }
            op if op.supports_propagation() => truth(&mut [&**left, &**right].into_iter()),
            _ => {
                of(left)?;
                of(right)?;
                Ok(Unit::Unknown)
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
        | Expr::IsNotUnknown(e) => of(e).map(|_| Unit::Unknown),
        Expr::Case(case) => {
            let whens = case.when_then_expr.iter().map(|(when, _)| &**when);
            match &case.expr {
                Some(compared) => same(&mut std::iter::once(&**compared).chain(whens))?,
                None => {
                    whens.map(of).collect::<Result<Vec<_>, Fault>>()?;
                    Unit::Unknown
                }
            };
            let values = case.when_then_expr.iter().map(|(_, then)| &**then);
            same(&mut values.chain(case.else_expr.as_deref()))
        }
        Expr::ScalarFunction(function) if KEEPING.contains(&function.name()) => same(&mut function.args.iter()),
        Expr::ScalarFunction(function) => {
            function.args.iter().map(of).collect::<Result<Vec<_>, Fault>>()?;
            Ok(Unit::Unknown)
        }
        _ => Ok(Unit::Unknown),
    }
}

/// Common unit of values that are added or compared. `second` is the expression with the second unit.
fn together(first: Unit, other: Unit, second: &Expr) -> Result<Unit, Fault> {
    Ok(match (first, other) {
        (Unit::Any, unit) | (unit, Unit::Any) => unit,
        (Unit::Of(a), Unit::Of(b)) if a == b => Unit::Of(a),
        (Unit::Of(a), Unit::Of(b)) if !a.is_empty() && !b.is_empty() => {
            let what = format!("`{second}` is in {b}, but it is added to or compared with a value in {a}");
            return Err(Fault::new(what).help("convert one of them by a factor, such as `0.3048 * x`"));
        }
        (Unit::Scaled(a) | Unit::Of(a), Unit::Scaled(b) | Unit::Of(b)) if a == b => Unit::Scaled(a),
        (Unit::Of(_) | Unit::Scaled(_) | Unit::Unknown, Unit::Of(_) | Unit::Scaled(_) | Unit::Unknown) => Unit::Unknown,
    })
}

fn product(a: Unit, b: Unit) -> Unit {
    match (a, b) {
        (Unit::Any, Unit::Any) => Unit::Any,
        (Unit::Any, Unit::Of(u) | Unit::Scaled(u)) | (Unit::Of(u) | Unit::Scaled(u), Unit::Any) => Unit::Scaled(u),
        (Unit::Of(one), unit @ Unit::Of(_)) | (unit @ Unit::Of(_), Unit::Of(one)) if one == "1" => unit,
        (Unit::Any | Unit::Of(_) | Unit::Scaled(_) | Unit::Unknown, _) => Unit::Unknown,
    }
}

fn quotient(a: Unit, b: Unit) -> Unit {
    match (a, b) {
        (Unit::Any, Unit::Any) => Unit::Any,
        (Unit::Of(u) | Unit::Scaled(u), Unit::Any) => Unit::Scaled(u),
        (Unit::Of(a), Unit::Of(b)) if a == b && !a.is_empty() => Unit::Of("1".to_owned()),
        (unit @ Unit::Of(_), Unit::Of(one)) if one == "1" => unit,
        (Unit::Any | Unit::Of(_) | Unit::Scaled(_) | Unit::Unknown, _) => Unit::Unknown,
    }
}
