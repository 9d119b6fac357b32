//! The time of each row of a file, from the clock of the mapping.

use arrow_array::{ArrayRef, RecordBatch, cast::AsArray, types::Int64Type};
use arrow_cast::cast;
use arrow_schema::{DataType, TimeUnit};
use schemas::{Fault, convert};

use super::{
    clock::{DAY_S, TimeText, TimeTextFormat, UtcInstant, digits_of, padded, read_date, read_zone},
    columns::{MappingColumns, is_text, numbers, texts},
    declare::{ClockZero, ConstantValue, TimeStampKeys},
    document::SpannedValue,
};
use crate::clock_digits;

/// The times of the rows of a batch.
pub enum RowTimes {
    /// Seconds past a midnight of unknown date, or of the log's own clock; NaN if missing.
    Undated(Vec<f64>),
    /// Instants of UTC.
    Dated(Vec<Option<UtcInstant>>),
}

/// Row whose text is not a time.
pub struct TimeParseError {
    /// The row of the batch.
    pub row: usize,
    /// The text.
    pub text: String,
}

/// Column that counts time in seconds or another unit.
#[derive(Clone, Debug)]
struct CounterColumn {
    at: usize,
    /// Nanoseconds per count, for whole numbers.
    ns: Option<i128>,
    /// Counts per second if that is a whole number; otherwise seconds per count.
    rate: Result<f64, f64>,
}

#[derive(Clone, Debug)]
enum ClockSource {
    Boot { ticks: CounterColumn, epoch: Option<UtcInstant> },
    Day { ticks: CounterColumn },
    Unix { ticks: CounterColumn },
    Gps { ticks: CounterColumn, week: GpsWeek, rollovers: i64, leap_s: Option<f64> },
    Text { columns: Vec<TimeTextColumn>, form: TimeTextFormat },
}

/// Column that holds a time as text, or a part of it.
#[derive(Clone, Debug)]
struct TimeTextColumn {
    at: usize,
    /// Number of digits before the decimal point, for a column of numbers.
    digits: Option<usize>,
}

impl TimeTextColumn {
    fn read(&self, batch: &RecordBatch) -> Result<Vec<Option<String>>, Fault> {
        match self.digits {
            None => texts(batch, self.at),
            Some(digits) => {
                let text = |x: f64| x.is_finite().then(|| padded(x, digits));
                Ok(numbers(batch, self.at)?.into_iter().map(text).collect())
            }
        }
    }
}

#[derive(Clone, Debug)]
enum GpsWeek {
    Column(usize),
    Number(i64),
}

/// The clock of a table, checked against the columns of a file. The reader must process all batches in order.
#[derive(Clone, Debug)]
pub struct TableClock {
    source: ClockSource,
    /// Offset of local time from UTC in seconds, positive east of Greenwich; `None` for UTC.
    zone_s: Option<f64>,
    /// The local date of the next row, for a clock that counts from midnight.
    day: Option<i64>,
    /// The last time of day that was not missing, in seconds.
    last_s: f64,
}

impl TableClock {
    /// Creates a clock. `epoch` is the instant at which the log's clock was 0; `None` if unknown.
    pub fn new(
        stamp: &SpannedValue<TimeStampKeys>,
        columns: &mut MappingColumns,
        epoch: Option<UtcInstant>,
    ) -> Option<TableClock> {
        let declared = &stamp.value;
        let Some(clock) = declared.clock else {
            let fault = Fault::new("`clock`, the origin of the time, is required");
            columns.push(fault.help("use `boot`, `day`, `unix`, `gps` or `text`").at(stamp.at.clone()));
            return None;
        };
        if declared.from.is_empty() {
            columns.push(Fault::new("`from`, the column of the time, is required").at(stamp.at.clone()));
            return None;
        }
        foreign_keys(stamp, clock, columns);
        let zone_s = zone(stamp, columns);
        refuse_second_zone(stamp, columns);
        let day = match &declared.date {
            None => None,
            Some(text) => match read_date(text) {
                Some(day) => Some(day),
                None => {
                    let fault = Fault::new(format!("`date` cannot be `{text}`")).help("write it as `2012-10-10`");
                    columns.push(fault.at(stamp.at("date")));
                    None
                }
            },
        };
        let source = match clock {
            ClockZero::Boot => ClockSource::Boot { ticks: ticks(stamp, columns)?, epoch },
            ClockZero::Day => ClockSource::Day { ticks: ticks(stamp, columns)? },
            ClockZero::Unix => ClockSource::Unix { ticks: ticks(stamp, columns)? },
            ClockZero::Gps => gps(stamp, columns)?,
            ClockZero::Text => text(stamp, columns)?,
        };
        Some(TableClock { source, zone_s, day, last_s: f64::NAN })
    }

    /// Whether the times have dates.
    pub fn is_dated(&self) -> bool {
        match &self.source {
            ClockSource::Boot { epoch, .. } => epoch.is_some(),
            ClockSource::Day { .. } => self.day.is_some(),
            ClockSource::Unix { .. } | ClockSource::Gps { .. } => true,
            ClockSource::Text { form, .. } => form.is_dated() || self.day.is_some(),
        }
    }

    /// Whether the clock counts from the start of the log.
    pub fn is_boot(&self) -> bool {
        matches!(self.source, ClockSource::Boot { .. })
    }

    /// The times of the next rows, and the rows whose text is not a time.
    pub fn read(&mut self, batch: &RecordBatch) -> Result<(RowTimes, Vec<TimeParseError>), Fault> {
        let mut wrong = vec![];
        let zone_s = self.zone_s.unwrap_or(0.0);
        let times = match self.source.clone() {
            ClockSource::Boot { ticks, epoch } => {
                let elapsed = ticks.seconds(batch)?;
                match epoch {
                    None => RowTimes::Undated(elapsed),
                    Some(epoch) => {
                        RowTimes::Dated(elapsed.iter().map(|s| s.is_finite().then(|| epoch.plus(*s))).collect())
                    }
                }
            }
            ClockSource::Day { ticks } => {
                let seconds = ticks.seconds(batch)?;
                if let Some(row) = clock_digits::minute_after(&seconds) {
                    return Err(in_digits(&seconds, row));
                }
                self.of_day(&seconds)
            }
            ClockSource::Unix { ticks } => {
                RowTimes::Dated(ticks.instants(batch)?.into_iter().map(|i| Some(i?.plus(-zone_s))).collect())
            }
            ClockSource::Gps { ticks, week, rollovers, leap_s } => {
                let seconds = ticks.seconds(batch)?;
                let weeks = match week {
                    GpsWeek::Number(n) => vec![n as f64; seconds.len()],
                    GpsWeek::Column(at) => numbers(batch, at)?,
                };
                let one = |(s, week): (&f64, &f64)| {
                    // A receiver without a fix reports week 0 or -1.
                    let known = s.is_finite() && *week >= 0.0 && week.fract() == 0.0 && *week < 1e6;
                    known.then(|| UtcInstant::of_gps(*week as i64 + 1024 * rollovers, *s, leap_s)).flatten()
                };
                RowTimes::Dated(seconds.iter().zip(&weeks).map(one).collect())
            }
            ClockSource::Text { columns, form } => {
                let cells = columns.iter().map(|cells| cells.read(batch)).collect::<Result<Vec<_>, _>>()?;
                let mut second = None;
                let mut read = |row: usize| -> Option<TimeText> {
                    let parts: Option<Vec<&str>> = cells.iter().map(|c| c.get(row)?.as_deref()).collect();
                    let text = parts?.join(" ");
                    if text.trim().is_empty() {
                        return None;
                    }
                    let time = form.read(&text);
                    if self.zone_s.is_some() && matches!(time, Some(TimeText::At { zoned: true, .. })) {
                        second.get_or_insert_with(|| text.clone());
                    }
                    if time.is_none() {
                        wrong.push(TimeParseError { row, text });
                    }
                    time
                };
                let all: Vec<Option<TimeText>> = (0..batch.num_rows()).map(&mut read).collect();
                if let Some(text) = second {
                    return Err(second_zone(&format!("the time `{text}` has its own offset from UTC")));
                }
                if form.is_dated() {
                    RowTimes::Dated(all.iter().map(|t| t.map(|t| at(t, zone_s))).collect())
                } else {
                    let of_day = |t: &Option<TimeText>| match t {
                        Some(TimeText::OfDay(s)) => *s,
                        Some(TimeText::At { .. }) | None => f64::NAN,
                    };
                    self.of_day(&all.iter().map(of_day).collect::<Vec<_>>())
                }
            }
        };
        Ok((times, wrong))
    }

    /// Times of a day; the date advances at midnight.
    fn of_day(&mut self, seconds: &[f64]) -> RowTimes {
        /// A backward step of the time leads to the next day only if it begins and ends within this distance of
        /// midnight, in seconds.
        const NEAR_S: f64 = 3_600.0;
        let zone_s = self.zone_s;
        let Some(mut day) = self.day else {
            let utc = |s: &f64| zone_s.map_or(*s, |zone| (s - zone).rem_euclid(DAY_S));
            return RowTimes::Undated(seconds.iter().map(utc).collect());
        };
        let mut last = self.last_s;
        let dated = seconds.iter().map(|&s| {
            if !s.is_finite() {
                return None;
            }
            if (DAY_S - NEAR_S..DAY_S + NEAR_S).contains(&last) && (0.0..NEAR_S).contains(&s) {
                day += 1;
            }
            last = s;
            Some(UtcInstant::new(day, s - zone_s.unwrap_or(0.0)))
        });
        let dated = dated.collect();
        (self.day, self.last_s) = (Some(day), last);
        RowTimes::Dated(dated)
    }
}

/// The instant of a time in text.
fn at(time: TimeText, zone_s: f64) -> UtcInstant {
    match time {
        TimeText::At { instant, zoned: true } => instant,
        TimeText::At { instant, zoned: false } => instant.plus(-zone_s),
        TimeText::OfDay(s) => UtcInstant::new(0, s),
    }
}

/// Rejects keys without effect for this clock.
fn foreign_keys(stamp: &SpannedValue<TimeStampKeys>, clock: ClockZero, columns: &mut MappingColumns) {
    let owners: [(&str, &[ClockZero]); 7] = [
        ("week", &[ClockZero::Gps]),
        ("rollovers", &[ClockZero::Gps]),
        ("leap_s", &[ClockZero::Gps]),
        ("format", &[ClockZero::Text]),
        ("zone", &[ClockZero::Day, ClockZero::Unix, ClockZero::Text]),
        ("date", &[ClockZero::Day, ClockZero::Text]),
        ("unit", &[ClockZero::Boot, ClockZero::Day, ClockZero::Unix, ClockZero::Gps]),
    ];
    for (key, clocks) in owners {
        if let Some(given) = stamp.args.get(key).filter(|_| !clocks.contains(&clock)) {
            let of: Vec<String> = clocks.iter().map(|c| format!("`{}`", c.word())).collect();
            let what = format!("`{key}` does not apply to the clock `{}`, only to {}", clock.word(), of.join(", "));
            columns.push(Fault::new(what).at(given.key_at.clone()));
        }
    }
    if clock != ClockZero::Text && stamp.value.from.len() > 1 {
        let what = format!("the clock `{}` requires one column, not {}", clock.word(), stamp.value.from.len());
        columns.push(Fault::new(what).at(stamp.at("from")));
    }
}

fn zone(stamp: &SpannedValue<TimeStampKeys>, columns: &mut MappingColumns) -> Option<f64> {
    let text = stamp.value.zone.as_ref()?;
    let zone = read_zone(text);
    if zone.is_none() {
        let fault = Fault::new(format!("`zone` cannot be `{text}`")).help("write it as `+10:00`, `-03:30` or `Z`");
        columns.push(fault.at(stamp.at("zone")));
    }
    zone
}

/// Rejects a zone for time stamps whose type or text already has a zone.
fn refuse_second_zone(stamp: &SpannedValue<TimeStampKeys>, columns: &mut MappingColumns) {
    if stamp.value.zone.is_none() {
        return;
    }
    for name in &stamp.value.from {
        let Ok(field) = columns.source.field_with_name(name) else { continue };
        if let DataType::Timestamp(_, Some(zone)) = field.data_type() {
            let fault = second_zone(&format!(
                "the type of `{name}` already contains the zone {zone}, so its times are converted to UTC"
            ));
            columns.push(fault.at(stamp.at("zone")));
        }
    }
    if TimeTextFormat::new(stamp.value.format.as_deref()).is_some_and(|form| form.is_zoned()) {
        columns.push(second_zone("the `format` contains an offset from UTC").at(stamp.at("zone")));
    }
}

fn second_zone(what: &str) -> Fault {
    Fault::data(format!("{what}; `zone` has no effect")).help("remove `zone`")
}

/// The fault of a time of day that is written as digits instead of seconds.
fn in_digits(numbers: &[f64], row: usize) -> Fault {
    let at = numbers.get(row).copied().unwrap_or(f64::NAN);
    let help = format!("use `clock = \"text\"` with `format` = {}, and remove `unit`", clock_digits::formats(numbers));
    Fault::data(format!("{}, for example to {at}", clock_digits::WHAT)).help(help)
}

/// The column of a clock that counts.
fn ticks(stamp: &SpannedValue<TimeStampKeys>, columns: &mut MappingColumns) -> Option<CounterColumn> {
    let name = stamp.value.from.first()?;
    of_column(name, stamp.value.unit.as_deref(), (stamp.at("from"), stamp.at("unit")), columns)
}

/// A column that counts time, in a unit that the mapping or the file gives.
fn of_column(
    name: &str,
    unit: Option<&str>,
    (from_at, unit_at): (super::document::MappingSpan, super::document::MappingSpan),
    columns: &mut MappingColumns,
) -> Option<CounterColumn> {
    let at = columns.find(name, from_at.clone())?;
    let field = columns.source.field(at);
    let declared = match field.data_type() {
        DataType::Timestamp(unit, _) => Some(match unit {
            TimeUnit::Second => "s",
            TimeUnit::Millisecond => "ms",
            TimeUnit::Microsecond => "us",
            TimeUnit::Nanosecond => "ns",
        }),
        _ => None,
    };
    let of_file = field.metadata().get("unit").map(String::as_str).filter(|u| !u.is_empty());
    let Some(unit) = declared.or(unit).or(of_file) else {
        let fault = Fault::new(format!("the unit of the time `{name}` is in neither the file nor the mapping"));
        columns.push(fault.help("set `unit`: `s`, `ms`, `us`, `ns`").at(from_at));
        return None;
    };
    let Some(factor) = convert(unit, "s") else {
        let what = format!("the time `{name}` cannot be in `{unit}`");
        columns.push(Fault::new(what).nearest(unit, &schemas::convertible_to("s")).at(unit_at));
        return None;
    };
    let kind = field.data_type();
    if !(kind.is_numeric() || declared.is_some()) {
        let fault = Fault::new(format!("the time `{name}` contains {kind}; only `clock = \"text\"` reads text"));
        columns.push(fault.at(from_at));
        return None;
    }
    let per_second = (1.0 / factor).round();
    let rate = if factor <= 1.0 && (per_second * factor - 1.0).abs() < 1e-12 { Ok(per_second) } else { Err(factor) };
    let ns = (factor * 1e9).round();
    let ns = (kind.is_integer() || declared.is_some()).then_some(ns as i128).filter(|n| *n > 0);
    Some(CounterColumn { at, ns, rate })
}

/// A column with the log's own clock, read in seconds.
pub struct BootColumn(CounterColumn);

impl BootColumn {
    /// Binds the column `name`, in a unit that the mapping or the file gives.
    pub fn new(
        name: &str,
        unit: Option<&str>,
        at: super::document::MappingSpan,
        columns: &mut MappingColumns,
    ) -> Option<BootColumn> {
        of_column(name, unit, (at.clone(), at), columns).map(BootColumn)
    }

    /// Values, in seconds.
    pub fn read(&self, batch: &RecordBatch) -> Result<Vec<f64>, Fault> {
        self.0.seconds(batch)
    }
}

impl CounterColumn {
    fn whole(&self, batch: &RecordBatch) -> Result<Option<ArrayRef>, Fault> {
        if self.ns.is_none() {
            return Ok(None);
        }
        let column = batch.columns().get(self.at).ok_or_else(|| Fault::bug("a batch lacks the time column"))?;
        cast(column, &DataType::Int64).map(Some).map_err(|e| Fault::data(e.to_string()))
    }

    /// Seconds; NaN if the time is missing.
    fn seconds(&self, batch: &RecordBatch) -> Result<Vec<f64>, Fault> {
        let one = |x: f64| match self.rate {
            Ok(per_second) => x / per_second,
            Err(factor) => x * factor,
        };
        Ok(numbers(batch, self.at)?.into_iter().map(one).collect())
    }

    /// Instants counted from 1970; whole numbers are exact.
    fn instants(&self, batch: &RecordBatch) -> Result<Vec<Option<UtcInstant>>, Fault> {
        if let (Some(ns), Some(whole)) = (self.ns, self.whole(batch)?) {
            let whole = whole.as_primitive::<Int64Type>();
            return Ok(whole.iter().map(|x| Some(UtcInstant::of_unix_ns(i128::from(x?) * ns))).collect());
        }
        // A count above 10^12 s is not in seconds, but for example in milliseconds.
        let instant = |s: f64| (s.abs() < 1e12).then(|| UtcInstant::new(0, s));
        Ok(self.seconds(batch)?.into_iter().map(instant).collect())
    }
}

fn gps(stamp: &SpannedValue<TimeStampKeys>, columns: &mut MappingColumns) -> Option<ClockSource> {
    let declared = &stamp.value;
    let week = match &declared.week {
        None => {
            let fault = Fault::new("`clock = \"gps\"` requires `week`, a column or a number");
            columns.push(fault.at(stamp.at.clone()));
            return None;
        }
        Some(ConstantValue::Number(x)) if x.fract() == 0.0 && (0.0..1e5).contains(x) => GpsWeek::Number(*x as i64),
        Some(ConstantValue::Number(x)) => {
            columns.push(
                Fault::new(format!("a GPS week must be a whole number, 0 or above, not {x}")).at(stamp.at("week")),
            );
            return None;
        }
        Some(ConstantValue::Text(name)) => GpsWeek::Column(columns.number(name, stamp.at("week"))?),
    };
    let rollovers = declared.rollovers as i64;
    Some(ClockSource::Gps { ticks: ticks(stamp, columns)?, week, rollovers, leap_s: declared.leap_s })
}

fn text(stamp: &SpannedValue<TimeStampKeys>, columns: &mut MappingColumns) -> Option<ClockSource> {
    let names = &stamp.value.from;
    let format = stamp.value.format.as_deref();
    // In a format for several columns, a space separates the parts of the columns.
    let parts: Vec<&str> = format.unwrap_or_default().split(' ').collect();
    let mut found = vec![];
    for (i, name) in names.iter().enumerate() {
        let at = columns.find(name, stamp.at("from"))?;
        if is_text(columns.source, at) {
            found.push(TimeTextColumn { at, digits: None });
            continue;
        }
        let kind = columns.source.field(at).data_type();
        let part = parts.get(i).filter(|_| parts.len() == names.len());
        let digits = part.and_then(|part| digits_of(part)).filter(|digits| *digits > 0 && kind.is_numeric());
        if digits.is_none() {
            let what = format!(
                "`{name}` contains {kind}, but `clock = \"text\"` requires text, or numbers whose \
                                digits are a date or time"
            );
            let help = "numbers require a `format` without separators, except for a blank between columns: \
                        `%H%M%S%.f` for hhmmss.s, `%Y%m%d %H%M` for a date and hhmm";
            columns.push(Fault::new(what).help(help).at(stamp.at("from")));
            return None;
        }
        found.push(TimeTextColumn { at, digits });
    }
    let Some(form) = TimeTextFormat::new(format) else {
        let text = stamp.value.format.clone().unwrap_or_default();
        let fault = Fault::new(format!("`format` cannot be `{text}`"));
        let help = "write a format that contains at least the hour, in the notation of `strftime`, such as `%d/%m/%Y \
                    %H:%M:%S%.f`";
        columns.push(fault.help(help).at(stamp.at("format")));
        return None;
    };
    if form.is_dated() && stamp.value.date.is_some() {
        columns.push(Fault::new("the text already contains the date").at(stamp.at("date")));
    }
    Some(ClockSource::Text { columns: found, form })
}
