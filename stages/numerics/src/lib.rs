//! The mathematics below the stages: slices and matrices in, vectors out.
//!
//! Nothing here knows tables, plans or files. A routine's documentation gives the shape, unit and
//! frame of what it takes and returns, its errors, and where its formula is printed.

pub mod anomaly_retention;
pub mod attitude;
pub mod attitude_terms;
pub mod bootstrap;
pub mod choose_lambda;
pub mod combine;
pub mod continuation;
pub mod core_field;
pub mod crossings;
pub mod dates;
pub mod diagnostics;
pub mod difference;
pub mod ekf;
pub mod elastic_net;
pub mod field_value;
pub mod figure_of_merit;
pub mod fill;
pub mod filter;
pub mod gauss_markov;
pub mod geodesy;
pub mod grid_projection;
pub mod gridding;
pub mod ins_error;
pub mod ins_series;
pub mod l_curve;
pub mod least_squares;
pub mod levelling;
pub mod magnetic_sources;
pub mod map_grid;
pub mod map_stack;
pub mod mechanisation;
pub mod model_terms;
pub mod natural_cubic;
pub mod noise;
pub mod pinson;
pub mod plane_grid;
pub mod pls;
pub mod principal_components;
pub mod recursive_least_squares;
pub mod resample;
pub mod robust;
pub mod segments;
pub mod spectrum;
pub mod statistics;
pub mod strapdown;
pub mod tolles_lawson;
pub mod transition;
pub mod truncated_svd;

#[cfg(test)]
mod reference_csv;
#[cfg(test)]
mod test_normals;
