//! List of all filters.

use super::{
    crlb::Crlb, ekf::Ekf, ekf_adaptive::EkfAdaptive, ekf_online_nn::EkfOnlineNn, ekf_online_tl::EkfOnlineTl,
    filter::FilterDecl, fixed_lag::FixedLag, iekf::Iekf, ins_only::InsOnly, mpf::Mpf, mpf_then_ekf::MpfThenEkf,
    nekf::Nekf, rts::Rts, slam::Slam, ukf::Ukf,
};

/// Every filter, in the order of the reference.
pub const FILTERS: &[&FilterDecl] = &[
    &Ekf::FILTER,
    &Iekf::FILTER,
    &Ukf::FILTER,
    &EkfAdaptive::FILTER,
    &Nekf::FILTER,
    &EkfOnlineTl::FILTER,
    &EkfOnlineNn::FILTER,
    &FixedLag::FILTER,
    &Rts::FILTER,
    &Mpf::FILTER,
    &MpfThenEkf::FILTER,
    &Slam::FILTER,
    &Crlb::FILTER,
    &InsOnly::FILTER,
];
