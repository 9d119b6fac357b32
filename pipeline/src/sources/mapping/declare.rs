//! What a mapping says, as it is declared: the keys of its tables, clocks, columns and sensors.

use schemas::{Fault, Lists, Literal, Nested, Param, ParamDoc, Reader, Rule, Sections, Value, choice, params};

choice! {
    /// What a time counts from.
    pub enum Clock {
        /// The start of the log; `epoch` says when that was.
        Boot = "boot",
        /// Midnight; of UTC, or of `zone`.
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
    /// Which entry of a quaternion is the real part.
    pub enum Order {
        /// The first.
        Wxyz = "wxyz",
        /// The last.
        Xyzw = "xyzw",
    }
}

choice! {
    /// The frames that a quaternion turns a vector from and to.
    pub enum Frames {
        /// Nose-right-down to north-east-down.
        FrdToNed = "frd_to_ned",
        /// Nose-left-up to east-north-up.
        FluToEnu = "flu_to_enu",
    }
}

choice! {
    /// What a column may be used for.
    pub enum ColumnRole {
        /// A target or reference, never a feature.
        Truth = "truth",
        /// What the aircraft measures.
        Sensor = "sensor",
        /// Anything else.
        Aux = "aux",
    }
}

/// A number or a text.
#[derive(Clone, Debug, PartialEq)]
pub enum Constant {
    /// A number.
    Number(f64),
    /// A text; where a column is meant, its name.
    Text(String),
}

impl Value for Constant {
    const TYPE: &'static str = "number or text";

    fn read(literal: &Literal) -> Option<Constant> {
        match literal.as_text() {
            Some(text) => Some(Constant::Text(text.to_owned())),
            None => f64::read(literal).map(Constant::Number),
        }
    }

    fn check(&self, rule: &Rule) -> Result<(), Fault> {
        match self {
            Constant::Number(x) => x.check(rule),
            Constant::Text(_) => Ok(()),
        }
    }

    fn canonical(&self) -> String {
        match self {
            Constant::Number(x) => x.canonical(),
            Constant::Text(text) => format!("{text:?}"),
        }
    }

    fn obtain(reader: &mut Reader, param: Param<Self>) -> Option<Self> {
        reader.plain(param)
    }

    fn document(doc: ParamDoc, _: &Lists) -> Vec<ParamDoc> {
        vec![doc]
    }
}

params! {
    /// A time as a file has it.
    pub struct Stamp, all default;
    /// The column of the time; several columns of text are joined by a space, such as a date and a time.
    from: Vec<String>, unit "", default Vec::<String>::new();
    /// What it counts from.
    clock: Option<Clock>, unit "", default None, absent "it must be given";
    /// The unit it counts in.
    unit: Option<String>, unit "", default None, absent "what the file says";
    /// The GPS week: a column or a number.
    week: Option<Constant>, unit "", default None, absent "it must be given with `clock = \"gps\"`";
    /// How often the 10 bits of the week that a receiver counts have run over since 1980: 2 from April 2019 on.
    rollovers: usize, unit "", default 0usize, rule Rule::Between(0.0, 10.0);
    /// GPS time less UTC.
    leap_s: Option<f64>, unit "s", default None, absent "that of the date", rule Rule::Between(0.0, 100.0);
    /// The form of the text, in the letters of `strftime`: `%d/%m/%Y %H:%M:%S%.f`.
    format: Option<String>, unit "", default None, absent "ISO 8601";
    /// The offset of local time from UTC: `+10:00` east of Greenwich. Times that have their own zone need none.
    zone: Option<String>, unit "", default None, absent "UTC";
    /// The date of the first row, for a time of the day: `2012-10-10`, in `zone` where that is given.
    date: Option<String>, unit "", default None, absent "not known";
}

params! {
    /// When a log's own clock was 0.
    pub struct Epoch, groups [
        /// The UTC time that is logged beside the log's own clock.
        stamp: Stamp,
    ];
    /// The UTC time at which the log's clock was 0: `2012-10-10`, or `2012-10-10T18:20:00Z`.
    utc: Option<String>, unit "", default None, absent "found from `from` and `boot`";
    /// The topic that holds both clocks.
    topic: Option<String>, unit "", default None, absent "that of the table";
    /// The file that holds both clocks, beside the log.
    file: Option<String>, unit "", default None, absent "the log";
    /// The column of the log's own clock there.
    boot: Option<String>, unit "", default None, absent "it must be given with `from`";
    /// Its unit.
    boot_unit: Option<String>, unit "", default None, absent "what the file says";
    /// What is added to `boot`: with -7.75, a clock that is 7.75 s behind that of `boot`.
    boot_offset_s: f64, unit "s", default 0.0, rule Rule::Finite;
    /// A SQL condition: the rows with a valid time.
    rows: Option<String>, unit "", default None, absent "all";
    /// `true`: nobody knows. `tt` is then the log's own clock, and there is no date.
    unknown: bool, unit "", default false;
}

params! {
    /// A flight or a line, where it is not one text for all.
    pub struct KeyOf, all default;
    /// The column that names it.
    from: Option<String>, unit "", default None, absent "another key says it";
    /// A SQL expression that names it.
    sql: Option<String>, unit "", default None, absent "another key says it";
    /// `true`: the name of the file, without its extension.
    of_file: bool, unit "", default false;
}

params! {
    /// A column of the flight table.
    pub struct ColumnOf, all default;
    /// The column of the file.
    from: Option<String>, unit "", default None, absent "another key says it";
    /// A SQL expression over the columns of the file, one row at a time; names in double quotes.
    sql: Option<String>, unit "", default None, absent "another key says it";
    /// One value for all rows.
    value: Option<Constant>, unit "", default None, absent "another key says it";
    /// The unit of the file's values, or of the value of `sql`; `scale` and `offset` are in it.
    unit: Option<String>, unit "", default None, absent "what the file says";
    /// The column is `scale` times the file's value, plus `offset`: -1 turns the sign.
    scale: f64, unit "1", default 1.0, rule Rule::Finite;
    /// What is added after that, in `unit`.
    offset: f64, unit "that of the column", default 0.0, rule Rule::Finite;
    /// What it may be used for, where its name does not say.
    role: Option<ColumnRole>, unit "", default None, absent "that of its name";
    /// What it is.
    description: Option<String>, unit "", default None, absent "that of its name";
}

params! {
    /// A vector sensor: three columns of the file in its own axes, turned into the body frame (nose, right wing, down).
    pub struct VectorOf, all default;
    /// The columns of the sensor's x, y and z.
    from: Vec<String>, unit "", default Vec::<String>::new();
    /// SQL expressions for the sensor's x, y and z, in place of `from`.
    sql: Vec<String>, unit "", default Vec::<String>::new();
    /// The unit of the file's values, or of those of `sql`.
    unit: Option<String>, unit "", default None, absent "what the file says";
    /// Factors of the sensor's x, y and z, or one for all.
    scale: Vec<f64>, unit "1", default vec![1.0], rule Rule::Finite;
    /// What is added to the sensor's x, y and z after that, in `unit`.
    offset: Vec<f64>, unit "that of the sensor", default vec![0.0, 0.0, 0.0], rule Rule::Finite;
    /// Which axis of the sensor lies along the nose, the right wing and down, each with its sign: `+x -y -z` is a sensor
    /// whose y and z axes point to the left and up.
    axes: String, unit "", default "+x +y +z";
    /// Roll, pitch and yaw of the sensor's axes (after `axes`) against those of the body:
    /// body = Rz(yaw) Ry(pitch) Rx(roll) sensor, the rotation that attitude angles describe.
    rotation_deg: Vec<f64>, unit "deg", default vec![0.0, 0.0, 0.0], rule Rule::Finite;
    /// What it may be used for, where its name does not say.
    role: Option<ColumnRole>, unit "", default None, absent "that of its name";
    /// What it is.
    description: Option<String>, unit "", default None, absent "that of its name";
}

params! {
    /// An attitude that the file holds as a quaternion.
    pub struct QuaternionOf;
    /// The four columns of the file.
    from: Vec<String>, unit "";
    /// The columns of roll, pitch and yaw.
    to: Vec<String>, unit "", default vec!["ins_roll".to_owned(), "ins_pitch".to_owned(), "ins_yaw".to_owned()];
    /// Which entry is the real part.
    order: Order, unit "", default Order::Wxyz;
    /// The frames it turns a vector from and to.
    frames: Frames, unit "", default Frames::FrdToNed;
}

params! {
    /// One table of a mapping, without its clock, keys and columns.
    pub struct Head, all default;
    /// The message, topic or array that it reads.
    topic: Option<String>, unit "", default None, absent "the file is one table";
    /// A pattern of the names of the files that hold it, such as `mag*.parquet`.
    file: Option<String>, unit "", default None, absent "any file";
    /// The format of the files.
    format: Option<String>, unit "", default None, absent "known from the content and the extension";
    /// A SQL condition; rows for which it does not hold are left out.
    rows: Option<String>, unit "", default None, absent "all";
    /// Whether columns that the mapping does not name come along under their own names.
    others: bool, unit "", default false;
    /// Whether a row that repeats the time of the row before is left out. Such rows are counted in a note.
    drop_repeated: bool, unit "", default false;
}

params! {
    /// The attitudes of a table.
    pub struct Attitudes, all default;
    /// Attitudes that the file holds as quaternions.
    quaternions: Sections<QuaternionOf>, unit "", default Vec::<QuaternionOf>::new();
}

params! {
    /// The clock of a table.
    pub struct Time;
    /// The time of each row.
    time: Nested<Stamp>, unit "";
    /// When the log's own clock was 0, for `clock = "boot"`.
    epoch: Option<Nested<Epoch>>, unit "", default None, absent "that of the mapping";
}
