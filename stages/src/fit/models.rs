//! The list of all models.

use super::{
    elastic_net::ElasticNet, extended_tolles_lawson::ExtendedTollesLawson, model::Model, pls::PartialLeastSquares,
    recursive_least_squares::RecursiveLeastSquares, ridge::Ridge, robust::Robust, tolles_lawson::TollesLawson,
    truncated_svd::TruncatedSvd,
};

/// Every model, in the order of the reference.
pub const MODELS: &[&Model] = &[
    &TollesLawson::MODEL,
    &ExtendedTollesLawson::MODEL,
    &Ridge::MODEL,
    &ElasticNet::MODEL,
    &PartialLeastSquares::MODEL,
    &TruncatedSvd::MODEL,
    &Robust::MODEL,
    &RecursiveLeastSquares::MODEL,
];
