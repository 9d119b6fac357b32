//! The mappings included in magline: the meaning of columns in logs of known programs. `mappings/README.md` describes
//! their format.

/// A mapping included in magline: its name and its text.
#[derive(Clone, Copy, Debug)]
pub struct BuiltinMapping {
    /// Name in the key `mapping`.
    pub name: &'static str,
    /// Text.
    pub text: &'static str,
}

macro_rules! ready {
    ($($name:literal),+ $(,)?) => {
        /// The included mappings; each is a file in `mappings`.
        pub const READY: &[BuiltinMapping] = &[
            $(BuiltinMapping {
                name: $name,
                text: include_str!(concat!("../mappings/", $name, ".toml")),
            }),+
        ];
    };
}

ready![
    "ardupilot_dataflash",
    "ardupilot_dataflash_timeus",
    "ardupilot_dataflash_timems",
    "px4_ulog",
    "px4_ulog_v114",
    "px4_ulog_2016",
    "skywalker_x8",
    "skywalker_x8_parquet",
    "thor75",
    "thor75_parquet",
    "magnavjl",
    "magnavjl_tl",
    "mfam",
];
