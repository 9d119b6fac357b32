//! The earth: its shape, its core field, attitudes relative to it, and dates.

pub mod attitude;
pub mod core_field;
pub mod dates;
pub mod field_value;
pub mod geodesy;
