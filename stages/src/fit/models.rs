//! The list of all models.

use super::{
    boosted_trees::BoostedTrees, elastic_net::ElasticNet, etlnn::ExtendedTollesLawsonNetwork,
    extended_tolles_lawson::ExtendedTollesLawson, gru::Gru, lstm::Lstm, m1::M1, m2a::M2a, m2b::M2b, m2c::M2c, m2d::M2d,
    m3s::M3s, m3sc::M3sc, m3tf::M3tf, m3tl::M3tl, m3v::M3v, m3vc::M3vc, m3w::M3w, model::FitModelDecl,
    pls::PartialLeastSquares, random_features::RandomFeatures, recursive_least_squares::RecursiveLeastSquares,
    ridge::Ridge, robust::Robust, tcn::Tcn, tlnn::TollesLawsonNetwork, tolles_lawson::TollesLawson,
    truncated_svd::TruncatedSvd,
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
    &M3tl::MODEL,
    &M3s::MODEL,
    &M3v::MODEL,
    &M3sc::MODEL,
    &M3vc::MODEL,
    &M3w::MODEL,
    &M3tf::MODEL,
    &TollesLawsonNetwork::MODEL,
    &ExtendedTollesLawsonNetwork::MODEL,
    &Gru::MODEL,
    &Lstm::MODEL,
    &Tcn::MODEL,
    &BoostedTrees::MODEL,
    &RandomFeatures::MODEL,
];
