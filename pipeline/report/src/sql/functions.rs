//! SQL functions of the earth's core field.

use std::sync::Arc;

use arrow_array::{Array, ArrayRef, Float64Array, cast::AsArray, types::Float64Type};
use arrow_schema::DataType;
use datafusion::{
    common::exec_datafusion_err,
    error::DataFusionError,
    logical_expr::{ColumnarValue, ScalarFunctionArgs, ScalarUDF, ScalarUDFImpl, Signature, Volatility},
    prelude::SessionContext,
};
use numerics::earth::core_field::{CoreFieldModel, CoreFieldTrack};

/// Registers `igrf(lat, lon, alt, decimal_year)` and `wmm(...)`, which return the magnitude of the core field in nT at
/// a position in degrees and metres above the WGS-84 ellipsoid. Also registers `igrf_n`, `igrf_e`, `igrf_d`, `wmm_n`,
/// `wmm_e` and `wmm_d`, which return the components of the field. A null or NaN argument gives null. An infinity, a
/// latitude beyond 90 degrees, a longitude outside -180 to 360, a height outside -10 to 2,000 km and a date that the
/// model does not cover are errors that name the value.
pub fn register(context: &SessionContext) {
    for (model, word) in [(CoreFieldModel::Igrf14, "igrf"), (CoreFieldModel::Wmm, "wmm")] {
        for (part, suffix) in [
            (SqlFieldComponent::Magnitude, ""),
            (SqlFieldComponent::North, "_n"),
            (SqlFieldComponent::East, "_e"),
            (SqlFieldComponent::Down, "_d"),
        ] {
            context.register_udf(ScalarUDF::new_from_impl(CoreFieldFunction::new(
                model,
                part,
                format!("{word}{suffix}"),
            )));
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum SqlFieldComponent {
    Magnitude,
    North,
    East,
    Down,
}

#[derive(Debug, PartialEq, Eq, Hash)]
struct CoreFieldFunction {
    model: CoreFieldModel,
    part: SqlFieldComponent,
    name: String,
    signature: Signature,
}

impl CoreFieldFunction {
    fn new(model: CoreFieldModel, part: SqlFieldComponent, name: String) -> Self {
        let signature = Signature::exact(vec![DataType::Float64; 4], Volatility::Immutable);
        Self { model, part, name, signature }
    }
}

impl ScalarUDFImpl for CoreFieldFunction {
    fn name(&self) -> &str {
        &self.name
    }

    fn signature(&self) -> &Signature {
        &self.signature
    }

    fn return_type(&self, _: &[DataType]) -> Result<DataType, DataFusionError> {
        Ok(DataType::Float64)
    }

    fn invoke_with_args(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue, DataFusionError> {
        let arrays = ColumnarValue::values_to_arrays(&args.args)?;
        let numbers: Vec<Vec<f64>> = arrays.iter().map(numbers).collect();
        let [lat, lon, alt, year] = numbers.as_slice() else {
            return Err(exec_datafusion_err!("{} takes lat, lon, alt and decimal_year", self.name));
        };
        let infinite = numbers.iter().zip(["latitude", "longitude", "height", "date"]);
        for (values, what) in infinite {
            if values.iter().any(|x| x.is_infinite()) {
                return Err(exec_datafusion_err!("{}: the {what} is infinite", self.name));
            }
        }
        let field = CoreFieldTrack::new(self.model).field(lat, lon, alt, year);
        let field = field.map_err(|e| exec_datafusion_err!("{}: {e}", self.name))?;
        let values = match self.part {
            SqlFieldComponent::Magnitude => field.magnitude_nt(),
            SqlFieldComponent::North => field.north_nt,
            SqlFieldComponent::East => field.east_nt,
            SqlFieldComponent::Down => field.down_nt,
        };
        let known = values.into_iter().map(|v| Some(v).filter(|v| v.is_finite()));
        Ok(ColumnarValue::Array(Arc::new(known.collect::<Float64Array>())))
    }
}

/// The numbers of an argument, NaN for null.
fn numbers(array: &ArrayRef) -> Vec<f64> {
    match array.as_primitive_opt::<Float64Type>() {
        Some(array) => array.iter().map(|x| x.unwrap_or(f64::NAN)).collect(),
        None => vec![f64::NAN; array.len()],
    }
}
