//! Declaration of a mapping: the keys of its tables, clocks, columns and sensors.

use schemas::{
    ChoiceRegistry, Fault, Literal, NestedParams, Param, ParamDoc, ParamReader, ParamValue, ParamsList, Rule, choice,
    params,
};

choice! {
    /// The origin of a time.
    pub enum ClockZero {
        /// The start of the log, given by `epoch`.
        Boot = "boot",
        /// Midnight in UTC or in `zone`.
        Day = "day",
        /// 1970-01-01 UTC.
        Unix = "unix",
        /// The start of a GPS week, `week`.
        Gps = "gps",
        /// Text, or digits in a number such as hhmmss.s, read by `format`.
        Text = "text",
    }
}

choice! {
    /// The order of the entries of a quaternion.
    pub enum QuaternionOrder {
        /// The real part is first.
        Wxyz = "wxyz",
        /// The real part is last.
        Xyzw = "xyzw",
    }
}

choice! {
    /// The source and target frames of a quaternion.
    pub enum QuaternionFrames {
        /// Nose-right-down to north-east-down.
        FrdToNed = "frd_to_ned",
        /// Nose-left-up to east-north-up.
        FluToEnu = "flu_to_enu",
    }
}

choice! {
    /// The permitted use of a column.
    pub enum ColumnRole {
        /// A target or reference, never a feature.
        Truth = "truth",
        /// A measurement of the aircraft.
        Sensor = "sensor",
        /// Anything else.
        Aux = "aux",
    }
}

/// A number or a string.
#[derive(Clone, Debug, PartialEq)]
pub enum ConstantValue {
    /// A number.
    Number(f64),
    /// A string; for a column, its name.
    Text(String),
}

impl ParamValue for ConstantValue {
    const TYPE: &'static str = "number or text";

    fn read(literal: &Literal) -> Option<ConstantValue> {
        match literal.as_text() {
            Some(text) => Some(ConstantValue::Text(text.to_owned())),
            None => f64::read(literal).map(ConstantValue::Number),
        }
    }

    fn check(&self, rule: &Rule) -> Result<(), Fault> {
        match self {
            ConstantValue::Number(x) => x.check(rule),
            ConstantValue::Text(_) => Ok(()),
        }
    }

    fn canonical(&self) -> String {
        match self {
            ConstantValue::Number(x) => x.canonical(),
            ConstantValue::Text(text) => format!("{text:?}"),
        }
    }

    fn obtain(reader: &mut ParamReader, param: Param<Self>) -> Option<Self> {
        reader.plain(param)
    }

    fn document(doc: ParamDoc, _: &ChoiceRegistry) -> Vec<ParamDoc> {
        vec![doc]
    }
}

params! {
    /// The time in a file.
    pub struct TimeStampKeys, all default;
    /// The column of the time. Several text columns, such as date and time, are joined by a space.
    from: Vec<String>, unit "", default Vec::<String>::new();
    /// The clock, given by the origin of its time.
    clock: Option<ClockZero>, unit "", default None, absent "required";
    /// The unit of the time.
    unit: Option<String>, unit "", default None, absent "from the file";
    /// The GPS week: a column or a number.
    week: Option<ConstantValue>, unit "", default None, absent "required with `clock = \"gps\"`";
    /// The number of rollovers of a receiver's 10-bit GPS week since 1980: 2 since April 2019.
    rollovers: usize, unit "", default 0usize, rule Rule::Between(0.0, 10.0);
    /// GPS time minus UTC.
    leap_s: Option<f64>, unit "s", default None, absent "from the date", rule Rule::Between(0.0, 100.0);
    /// The format of the text, in `strftime` notation: `%d/%m/%Y %H:%M:%S%.f`.
    format: Option<String>, unit "", default None, absent "ISO 8601";
    /// The offset of local time from UTC, such as `+10:00` east of Greenwich. Times with a zone in their type or text
    /// require no offset.
    zone: Option<String>, unit "", default None, absent "UTC";
    /// The date of the first row, for a time of the day: `2012-10-10`, in `zone` if it is set.
    date: Option<String>, unit "", default None, absent "unknown";
}

params! {
    /// The time at which a log's own clock was 0.
    pub struct LogEpochKeys, groups [
        /// The UTC time that is recorded together with the log's own clock.
        stamp: TimeStampKeys,
    ];
    /// The UTC time at which the log's clock was 0: `2012-10-10`, or `2012-10-10T18:20:00Z`.
    utc: Option<String>, unit "", default None, absent "computed from `from` and `boot`";
    /// The topic that holds both clocks.
    topic: Option<String>, unit "", default None, absent "the topic of the table";
    /// The file with both clocks, in the folder of the log.
    file: Option<String>, unit "", default None, absent "the log";
    /// The column of the log's own clock in this topic or file.
    boot: Option<String>, unit "", default None, absent "required with `from`";
    /// The unit of `boot`.
    boot_unit: Option<String>, unit "", default None, absent "from the file";
    /// The offset added to `boot`: -7.75 if the log's clock is 7.75 s behind the clock of `boot`.
    boot_offset_s: f64, unit "s", default 0.0, rule Rule::Finite;
    /// An SQL condition that selects the rows with a valid time.
    rows: Option<String>, unit "", default None, absent "all";
    /// `true` if the start time is unknown. `tt` is then the log's own clock, without a date.
    unknown: bool, unit "", default false;
}

params! {
    /// The flight or line of each row, if it is not the same for all rows.
    pub struct RowIdentifierKeys, all default;
    /// The column with the identifier.
    from: Option<String>, unit "", default None, absent "set by another key";
    /// An SQL expression for the identifier.
    sql: Option<String>, unit "", default None, absent "set by another key";
    /// `true`: the name of the file, without its extension.
    of_file: bool, unit "", default false;
}

params! {
    /// A column of the flight table.
    pub struct MappingColumnKeys, all default;
    /// The column of the file.
    from: Option<String>, unit "", default None, absent "set by another key";
    /// An SQL expression over the columns of the file, evaluated for each row. Write column names in double quotes.
    sql: Option<String>, unit "", default None, absent "set by another key";
    /// One value for all rows.
    value: Option<ConstantValue>, unit "", default None, absent "set by another key";
    /// The unit of the file's values or of the result of `sql`, after `scale` and `offset`.
    unit: Option<String>, unit "", default None, absent "from the file";
    /// The factor on the file's values, before `offset` is added; -1 changes the sign.
    scale: f64, unit "1", default 1.0, rule Rule::Finite;
    /// The offset added after `scale`, in `unit`.
    offset: f64, unit "of the column", default 0.0, rule Rule::Finite;
    /// The permitted use of the column, if its name does not determine it.
    role: Option<ColumnRole>, unit "", default None, absent "from its name";
    /// The description of the column.
    description: Option<String>, unit "", default None, absent "from its name";
}

params! {
    /// A vector sensor: three columns in sensor axes, rotated to the body frame (nose, right wing, down).
    pub struct VectorSensorKeys, all default;
    /// The columns of the sensor's x, y and z.
    from: Vec<String>, unit "", default Vec::<String>::new();
    /// SQL expressions for the sensor's x, y and z, instead of `from`.
    sql: Vec<String>, unit "", default Vec::<String>::new();
    /// The unit of the file's values, or of the results of `sql`.
    unit: Option<String>, unit "", default None, absent "from the file";
    /// The factors of the sensor's x, y and z, or one factor for all.
    scale: Vec<f64>, unit "1", default vec![1.0], rule Rule::Finite;
    /// The offsets added to the sensor's x, y and z after `scale`, in `unit`.
    offset: Vec<f64>, unit "of the sensor", default vec![0.0, 0.0, 0.0], rule Rule::Finite;
    /// The signed sensor axes along the nose, the right wing and down. `+x -y -z` is a sensor whose y and z axes point
    /// to the left and up.
    axes: String, unit "", default "+x +y +z";
    /// Roll, pitch and yaw of the sensor's axes (after `axes`) relative to the body axes:
    /// body = Rz(yaw) Ry(pitch) Rx(roll) sensor, the rotation of attitude angles.
    rotation_deg: Vec<f64>, unit "deg", default vec![0.0, 0.0, 0.0], rule Rule::Finite;
    /// The permitted use of the column, if its name does not determine it.
    role: Option<ColumnRole>, unit "", default None, absent "from its name";
    /// The description of the column.
    description: Option<String>, unit "", default None, absent "from its name";
}

params! {
    /// An attitude in the form of a quaternion.
    pub struct QuaternionKeys;
    /// The four columns of the file.
    from: Vec<String>, unit "";
    /// The columns of roll, pitch and yaw.
    to: Vec<String>, unit "", default vec!["ins_roll".to_owned(), "ins_pitch".to_owned(), "ins_yaw".to_owned()];
    /// The order of the entries.
    order: QuaternionOrder, unit "", default QuaternionOrder::Wxyz;
    /// The source and target frames of the rotation.
    frames: QuaternionFrames, unit "", default QuaternionFrames::FrdToNed;
}

params! {
    /// A position in eastings and northings.
    pub struct ProjectedPositionKeys;
    /// The column of eastings.
    easting: String, unit "";
    /// The column of northings.
    northing: String, unit "";
    /// The EPSG code of the coordinate system, such as 32754 for UTM zone 54 south.
    epsg: u16, unit "";
    /// The unit of the eastings and northings.
    unit: Option<String>, unit "", default None, absent "from the file, else the unit of the coordinate system";
    /// The columns of latitude and longitude.
    to: Vec<String>, unit "", default vec!["lat".to_owned(), "lon".to_owned()];
}

params! {
    /// One table of a mapping, without its clock, keys and columns.
    pub struct MappingTableKeys, all default;
    /// The message, topic or array of the table.
    topic: Option<String>, unit "", default None, absent "the file is one table";
    /// A pattern for the names of its files, such as `mag*.parquet`.
    file: Option<String>, unit "", default None, absent "any file";
    /// The format of the files.
    format: Option<String>, unit "", default None, absent "from content and extension";
    /// An SQL condition that selects rows; other rows are dropped.
    rows: Option<String>, unit "", default None, absent "all";
    /// Whether to keep the columns that the mapping does not name, under their own names.
    others: bool, unit "", default false;
    /// Whether to drop a row with the same time as the previous row. A note gives the number of dropped rows.
    drop_repeated: bool, unit "", default false;
    /// The rate of rows that repeat the time of the previous row, such as 10 Hz for rows with times in whole seconds.
    /// These rows follow the first row of that time at this rate. A note gives their number.
    repeated_rate_hz: Option<f64>, unit "Hz", default None, absent "repeated times remain", rule Rule::Positive;
}

params! {
    /// The attitudes of a table.
    pub struct AttitudeKeys, all default;
    /// Attitudes in the form of quaternions.
    quaternions: ParamsList<QuaternionKeys>, unit "", default Vec::<QuaternionKeys>::new();
}

params! {
    /// The clock of a table.
    pub struct TableClockKeys;
    /// The time of each row.
    time: NestedParams<TimeStampKeys>, unit "";
    /// The time at which the log's own clock was 0, for `clock = "boot"`.
    epoch: Option<NestedParams<LogEpochKeys>>, unit "", default None, absent "the epoch of the mapping";
}
