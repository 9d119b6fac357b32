//! Lines found in simulated flights, whose lines are known, and in real ones.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::path::Path;

use datasets::{FlightOptions, Reading};
use tempfile::TempDir;

use super::*;
use crate::sources::{mapping::Mapping, open_log};
