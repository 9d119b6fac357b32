//! The list of all models.

use super::{
    boosted_trees::BoostedTrees, elastic_net::ElasticNet, etlnn::ExtendedTollesLawsonNetwork,
    extended_tolles_lawson::ExtendedTollesLawson, gru::Gru, lstm::Lstm, m1::M1, m2a::M2a, m2b::M2b, m2c::M2c, m2d::M2d,
    model::FitModelDecl, pls::PartialLeastSquares, random_features::RandomFeatures,
    recursive_least_squares::RecursiveLeastSquares, ridge::Ridge, robust::Robust, tcn::Tcn, tlnn::TollesLawsonNetwork,
    tolles_lawson::TollesLawson, truncated_svd::TruncatedSvd,
};

/// Every model, in the order of the reference.
pub const MODELS: &[&FitModelDecl] = &[
    &TollesLawson::MODEL,
    &ExtendedTollesLawson::MODEL,
    &Ridge::MODEL,
    &ElasticNet::MODEL,
    &PartialLeastSquares::MODEL,
    &TruncatedSvd::MODEL,
    &Robust::MODEL,
    &RecursiveLeastSquares::MODEL,
    &M1::MODEL,
    &M2a::MODEL,
    &M2b::MODEL,
    &M2c::MODEL,
    &M2d::MODEL,
    &TollesLawsonNetwork::MODEL,
    &ExtendedTollesLawsonNetwork::MODEL,
    &Gru::MODEL,
    &Lstm::MODEL,
    &Tcn::MODEL,
    &BoostedTrees::MODEL,
    &RandomFeatures::MODEL,
];
