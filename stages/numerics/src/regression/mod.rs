//! Linear models and their statistics: least squares, shrinkage, components, robust losses, recursion.

pub mod bootstrap;
pub mod choose_lambda;
pub mod elastic_net;
pub mod l_curve;
pub mod least_squares;
pub mod pls;
pub mod principal_components;
pub mod recursive_least_squares;
pub mod robust;
pub mod statistics;
pub mod truncated_svd;
