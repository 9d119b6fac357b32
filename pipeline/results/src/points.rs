//! The points of a table with their parameters, without repetitions.

use std::{
    collections::{BTreeMap, HashMap},
    fmt,
};

use serde::{
    Deserialize, Deserializer, Serialize,
    de::{Error, MapAccess, SeqAccess, Visitor, value::MapAccessDeserializer},
};

/// The values of a point by axis, and its parameters by name.
pub type SnapshotPoint = (BTreeMap<String, String>, BTreeMap<String, String>);

/// The points of a table with their parameters. Each axis and each parameter has a list of its distinct values. For a
/// grid of points, the size thus depends on the number of distinct values rather than on the number of points.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct SnapshotPoints {
    /// Number of points.
    count: usize,
    axes: BTreeMap<String, RepeatedValues>,
    parameters: BTreeMap<String, RepeatedValues>,
}

/// The values of one axis or parameter at all points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct RepeatedValues {
    /// The distinct values in the order of their first point.
    values: Vec<String>,
    /// Number of successive points with the same value, if the values repeat in a fixed cycle.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    every: Option<usize>,
    /// Position of the value of each point, if the values do not repeat in a fixed cycle; `None` for a point without a
    /// value.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    at: Vec<Option<u32>>,
}

impl RepeatedValues {
    fn get(&self, point: usize) -> Option<&String> {
        let at = match self.every {
            Some(every) => (point / every.max(1)).checked_rem(self.values.len())?,
            None => (*self.at.get(point)?)? as usize,
        };
        self.values.get(at)
    }

    /// Whether there is a valid position for each of `count` points.
    fn is_valid(&self, count: usize) -> bool {
        let inside = |at: &Option<u32>| at.is_none_or(|at| (at as usize) < self.values.len());
        match self.every {
            Some(every) => every > 0 && !self.values.is_empty() && self.at.is_empty(),
            None => self.at.len() == count && self.at.iter().all(inside),
        }
    }
}

/// Collects the values of one axis or parameter, point by point.
#[derive(Default)]
struct ValueCollector {
    known: HashMap<String, u32>,
    values: Vec<String>,
    at: Vec<Option<u32>>,
}

impl ValueCollector {
    fn add(&mut self, point: usize, value: String) {
        let next = self.values.len() as u32;
        let at = match self.known.get(&value) {
            Some(known) => *known,
            None => {
                self.values.push(value.clone());
                self.known.insert(value, next);
                next
            }
        };
        self.at.resize(point, None);
        self.at.push(Some(at));
    }

    fn finish(mut self, count: usize) -> RepeatedValues {
        self.at.resize(count, None);
        let every = self.at.iter().take_while(|at| **at == Some(0)).count();
        let turn = |point: usize| (point / every.max(1)) % self.values.len().max(1);
        let regular = self.at.iter().enumerate().all(|(point, at)| at.is_some_and(|at| at as usize == turn(point)));
        match every > 0 && regular {
            true => RepeatedValues { values: self.values, every: Some(every), at: vec![] },
            false => RepeatedValues { values: self.values, every: None, at: self.at },
        }
    }
}

impl FromIterator<SnapshotPoint> for SnapshotPoints {
    fn from_iter<I: IntoIterator<Item = SnapshotPoint>>(points: I) -> SnapshotPoints {
        let mut collectors: [BTreeMap<String, ValueCollector>; 2] = Default::default();
        let mut count = 0;
        for (axes, parameters) in points {
            for (collector, map) in collectors.iter_mut().zip([axes, parameters]) {
                for (name, value) in map {
                    match collector.get_mut(&name) {
                        Some(known) => known.add(count, value),
                        None => collector.entry(name).or_default().add(count, value),
                    }
                }
            }
            count += 1;
        }
        let finished = |collector: BTreeMap<String, ValueCollector>| {
            collector.into_iter().map(|(name, values)| (name, values.finish(count))).collect()
        };
        let [axes, parameters] = collectors.map(finished);
        SnapshotPoints { count, axes, parameters }
    }
}

impl SnapshotPoints {
    /// The number of points.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The points in their order.
    pub fn iter(&self) -> impl Iterator<Item = SnapshotPoint> + '_ {
        let of = |all: &BTreeMap<String, RepeatedValues>, point: usize| -> BTreeMap<String, String> {
            all.iter().filter_map(|(name, values)| Some((name.clone(), values.get(point)?.clone()))).collect()
        };
        (0..self.count).map(move |point| (of(&self.axes, point), of(&self.parameters, point)))
    }

    /// The distinct values of each axis, in the order of the points.
    pub fn axis_values(&self) -> BTreeMap<String, Vec<String>> {
        self.axes.iter().map(|(name, values)| (name.clone(), values.values.clone())).collect()
    }

    /// The distinct values of each parameter, in the order of the points.
    pub fn parameters(&self) -> impl Iterator<Item = (&str, &[String])> {
        self.parameters.iter().map(|(name, values)| (name.as_str(), values.values.as_slice()))
    }

    /// A parameter at the first point.
    pub fn first_parameter(&self, name: &str) -> Option<&String> {
        self.parameters.get(name)?.get(0)
    }

    /// These points; `None` if a position is invalid or there are more points than the axes allow.
    fn checked(self) -> Option<SnapshotPoints> {
        // Without axes, all points are equal.
        let most = self.axes.values().map(|v| v.values.len().max(1)).fold(1, usize::saturating_mul);
        let valid = self.axes.values().chain(self.parameters.values()).all(|v| v.is_valid(self.count));
        (valid && self.count <= most).then_some(self)
    }
}

impl<'de> Deserialize<'de> for SnapshotPoints {
    /// Reads the points, also from the list of points that earlier versions wrote.
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(PointsVisitor)
    }
}

struct PointsVisitor;

impl<'de> Visitor<'de> for PointsVisitor {
    type Value = SnapshotPoints;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("the points of a table")
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<SnapshotPoints, A::Error> {
        #[derive(Deserialize)]
        struct StoredPoints {
            count: usize,
            axes: BTreeMap<String, RepeatedValues>,
            parameters: BTreeMap<String, RepeatedValues>,
        }
        let StoredPoints { count, axes, parameters } = StoredPoints::deserialize(MapAccessDeserializer::new(map))?;
        let points = SnapshotPoints { count, axes, parameters };
        points.checked().ok_or_else(|| A::Error::custom("the number of values does not match the number of points"))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut points: A) -> Result<SnapshotPoints, A::Error> {
        let mut fault = None;
        let next = || match points.next_element::<SnapshotPoint>() {
            Ok(point) => point,
            Err(e) => {
                fault = Some(e);
                None
            }
        };
        let found = std::iter::from_fn(next).collect();
        fault.map_or(Ok(found), Err)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn map(pairs: &[(&str, String)]) -> BTreeMap<String, String> {
        pairs.iter().map(|(name, value)| ((*name).to_owned(), value.clone())).collect()
    }

    /// A grid of 3 by 4 points; `trim` exists at some points only, and `lambda` has one value.
    fn points() -> Vec<SnapshotPoint> {
        let one = |i: usize| {
            let axes = map(&[("mag", format!("mag_{}", i / 4)), ("trim", (i % 4).to_string())]);
            let mut parameters = map(&[("lambda", "0.5".to_owned()), ("target", format!("\"mag_{}\"", i / 4))]);
            if i.is_multiple_of(3) {
                parameters.insert("rank".to_owned(), (i % 2).to_string());
            }
            (axes, parameters)
        };
        (0..12).map(one).collect()
    }

    #[test]
    fn unit_points_are_stored_without_repetitions_and_read_again() {
        let packed: SnapshotPoints = points().into_iter().collect();
        assert_eq!((packed.len(), packed.iter().collect::<Vec<_>>()), (12, points()));
        let text = serde_json::to_string(&packed).unwrap();
        assert_eq!(text.matches("mag_1").count(), 2, "once as a value of the axis and once of the parameter: {text}");
        assert_eq!(serde_json::from_str::<SnapshotPoints>(&text).unwrap(), packed);
        assert_eq!(packed.axis_values()["trim"], ["0", "1", "2", "3"]);
        assert_eq!(packed.first_parameter("rank").unwrap(), "0");
        // Points of a search are not on a grid.
        let mut some = points();
        some.swap(1, 7);
        some.remove(4);
        let packed: SnapshotPoints = some.clone().into_iter().collect();
        let read: SnapshotPoints = serde_json::from_str(&serde_json::to_string(&packed).unwrap()).unwrap();
        assert_eq!(read.iter().collect::<Vec<_>>(), some);
        let none = SnapshotPoints::default();
        assert!(none.is_empty() && none.iter().next().is_none());
        assert_eq!(serde_json::from_str::<SnapshotPoints>(&serde_json::to_string(&none).unwrap()).unwrap(), none);
    }

    #[test]
    fn unit_the_list_of_earlier_versions_is_read() {
        let text = serde_json::to_string(&points()).unwrap();
        let read: SnapshotPoints = serde_json::from_str(&text).unwrap();
        assert_eq!(read, points().into_iter().collect());
        assert!(serde_json::from_str::<SnapshotPoints>(r#"[[{"a": "1"}, {}], 7]"#).is_err());
    }

    #[test]
    fn unit_points_with_wrong_positions_are_rejected() {
        let text = |count: usize, values: &str| {
            format!(r#"{{"count": {count}, "axes": {{"a": {{{values}}}}}, "parameters": {{}}}}"#)
        };
        let read = |count, values: &str| serde_json::from_str::<SnapshotPoints>(&text(count, values));
        assert!(read(2, r#""values": ["1", "2"], "every": 1"#).is_ok());
        for (count, values) in [
            (3, r#""values": ["1", "2"], "every": 1"#),
            (2, r#""values": ["1", "2"], "every": 0"#),
            (1, r#""values": [], "every": 1"#),
            (2, r#""values": ["1", "2"], "at": [0]"#),
            (2, r#""values": ["1", "2"], "at": [0, 2]"#),
            (usize::MAX, r#""values": ["1"], "every": 1"#),
        ] {
            assert!(read(count, values).is_err(), "{count} {values}");
        }
    }
}
