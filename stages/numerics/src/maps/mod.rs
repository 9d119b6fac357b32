//! Maps of the magnetic anomaly: grids, levelling, gridding, filling, continuation, look-up.

pub mod anomaly_retention;
pub mod combine;
pub mod continuation;
pub mod crossings;
pub mod fill;
pub mod grid_projection;
pub mod gridding;
pub mod levelling;
pub mod magnetic_sources;
pub mod map_stack;
pub mod map_surface;
pub mod plane_grid;
pub mod projection;
