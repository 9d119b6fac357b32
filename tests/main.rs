//! User interface of magline: the command line, its tables and its messages.
//!
//! Every test runs the built binary on files in a separate folder. The prefix of a test gives its reference: `law_`
//! physics or algebra, `val_` another program, `ref_` a published number, `gold_` a fixed text, `user_` the visible
//! behaviour, `unit_` anything else.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod architecture;
mod bad_input;
mod baselines;
mod bench;
mod bytes;
mod calibration;
#[cfg(feature = "cluster")]
mod cluster;
#[cfg(feature = "cluster")]
mod cluster_strangers;
#[cfg(feature = "cluster")]
mod cluster_support;
mod comparisons;
mod corrections;
mod cost;
mod examples;
mod exchange;
mod export;
mod failures;
mod field;
mod figures;
mod filters;
mod first_minutes;
mod fuzz;
mod ingest;
mod init;
mod json_schema;
mod killed;
mod lines;
mod log_stages;
mod loggers;
mod map_error;
mod map_lookup;
mod map_stages;
mod maps;
mod memory;
mod models;
mod navigation;
mod nekf;
mod networks;
mod openlineage;
mod other_simulator;
mod plausible;
mod power_loss;
mod publish;
mod publish_restricted;
mod queries;
mod query_safety;
mod rasters;
mod rates;
mod readers;
mod recovered_models;
mod reuse;
mod schedule;
mod scores;
mod search;
#[cfg(feature = "object-stores")]
mod secrets;
mod security;
#[cfg(feature = "serve")]
mod serve;
mod store;
mod structure;
mod support;
mod tasks;
mod text_fields;
mod trust;
mod versions;
#[cfg(feature = "serve")]
mod view;
mod warnings;
mod whole_numbers;
mod words;
