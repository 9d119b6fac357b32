//! The aircraft's own field: the terms of Tolles and Lawson and how well they explain a flight.

pub mod attitude_terms;
pub mod diagnostics;
pub mod figure_of_merit;
pub mod model_terms;
pub mod tolles_lawson;
