//! Names and order of the Tolles-Lawson terms.

use super::AMatrixError;

/// Position of each family in the full row of 22 terms.
pub(super) const INDUCED: usize = 3;
pub(super) const EDDY: usize = 9;
pub(super) const DERIVATIVE: usize = 18;
pub(super) const COLUMNS: usize = 22;

const NAMES: [&str; COLUMNS] = [
    "x", "y", "z", "xx", "xy", "xz", "yy", "yz", "zz", "xx_dot", "xy_dot", "xz_dot", "yx_dot", "yy_dot", "yz_dot",
    "zx_dot", "zy_dot", "zz_dot", "x_dot", "y_dot", "z_dot", "bias",
];

/// Physical cause of a group of terms. A matrix contains at most one group of each family.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum TermFamily {
    /// The aircraft's permanent magnetisation.
    Permanent,
    /// Magnetisation induced by the earth's field.
    Induced,
    /// Eddy currents, driven by the change of the field in the body frame.
    Eddy,
    /// The change of the field itself.
    Derivative,
    /// A constant.
    Bias,
}

/// One group of terms that can be requested.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TermGroup {
    /// Name.
    pub name: &'static str,
    /// Aliases, most of which are the names in MagNav.jl.
    pub aliases: &'static [&'static str],
    /// Family.
    pub family: TermFamily,
    columns: &'static [usize],
}

/// All groups of terms, in the order of their columns.
static GROUPS: [TermGroup; 9] = [
    TermGroup {
        name: "permanent",
        aliases: &["p", "permanent3", "p3"],
        family: TermFamily::Permanent,
        columns: &[0, 1, 2],
    },
    TermGroup {
        name: "induced",
        aliases: &["i", "induced6", "i6"],
        family: TermFamily::Induced,
        columns: &[3, 4, 5, 6, 7, 8],
    },
    TermGroup { name: "induced5", aliases: &["i5"], family: TermFamily::Induced, columns: &[3, 4, 5, 6, 7] },
    TermGroup { name: "induced3", aliases: &["i3"], family: TermFamily::Induced, columns: &[3, 6, 8] },
    TermGroup {
        name: "eddy",
        aliases: &["e", "eddy9", "e9"],
        family: TermFamily::Eddy,
        columns: &[9, 10, 11, 12, 13, 14, 15, 16, 17],
    },
    TermGroup { name: "eddy8", aliases: &["e8"], family: TermFamily::Eddy, columns: &[9, 10, 11, 12, 13, 14, 15, 16] },
    TermGroup { name: "eddy3", aliases: &["e3"], family: TermFamily::Eddy, columns: &[9, 13, 17] },
    TermGroup {
        name: "derivative",
        aliases: &["derivative3", "fdm", "fdm3", "f", "f3", "d", "d3"],
        family: TermFamily::Derivative,
        columns: &[18, 19, 20],
    },
    TermGroup { name: "bias", aliases: &["b"], family: TermFamily::Bias, columns: &[21] },
];

pub(super) fn names_of_groups() -> String {
    let names: Vec<&str> = GROUPS.iter().map(|group| group.name).collect();
    names.join(", ")
}

/// Selected terms of an A-matrix. Groups are in the order of the table, not of the request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TermSelection {
    groups: Vec<&'static TermGroup>,
    columns: Vec<usize>,
}

impl TermSelection {
    /// Selects the named groups: `permanent`, `induced` (`induced5` without zz, `induced3` the diagonal), `eddy`
    /// (`eddy8` without zz_dot, `eddy3` the diagonal), `derivative`, `bias`, or their short names.
    ///
    /// # Errors
    /// Fails with [`AMatrixError::Unknown`] for an unknown name, with [`AMatrixError::SameFamily`] for two groups of
    /// the same family, or with [`AMatrixError::Empty`] without names.
    pub fn new<S: AsRef<str>>(names: &[S]) -> Result<Self, AMatrixError> {
        let mut groups: Vec<&'static TermGroup> = Vec::new();
        for name in names {
            let group = find(name.as_ref())?;
            match groups.iter().find(|held| held.family == group.family) {
                None => groups.push(group),
                Some(held) if held.name == group.name => {}
                Some(held) => {
                    return Err(AMatrixError::SameFamily { one: held.name, other: group.name });
                }
            }
        }
        if groups.is_empty() {
            return Err(AMatrixError::Empty);
        }
        groups.sort_by_key(|group| group.family);
        let columns = groups.iter().flat_map(|group| group.columns).copied().collect();
        Ok(Self { groups, columns })
    }

    /// Groups whose columns match the start of a list of names; larger groups are preferred.
    ///
    /// # Errors
    /// Fails with [`AMatrixError::Empty`] if no group begins with the first name.
    pub fn leading<S: AsRef<str>>(names: &[S]) -> Result<Self, AMatrixError> {
        let mut known: Vec<&'static TermGroup> = GROUPS.iter().collect();
        known.sort_by_key(|group| (group.family, std::cmp::Reverse(group.columns.len())));
        let (mut groups, mut columns): (Vec<&'static TermGroup>, Vec<usize>) = (vec![], vec![]);
        for group in known {
            let new = groups.last().is_none_or(|last| last.family != group.family);
            let rest = names.get(columns.len()..).unwrap_or_default();
            let same = |(name, column): (&S, &usize)| name.as_ref() == NAMES[*column];
            if new && rest.len() >= group.columns.len() && rest.iter().zip(group.columns).all(same) {
                groups.push(group);
                columns.extend(group.columns);
            }
        }
        if groups.is_empty() { Err(AMatrixError::Empty) } else { Ok(Self { groups, columns }) }
    }

    /// The selected groups, in the order of their columns.
    pub fn groups(&self) -> &[&'static TermGroup] {
        &self.groups
    }

    /// The name of each term, in the order of the columns.
    pub fn names(&self) -> Vec<&'static str> {
        self.columns.iter().map(|&column| NAMES[column]).collect()
    }

    /// Number of terms.
    pub fn len(&self) -> usize {
        self.columns.len()
    }

    /// Whether there are no terms; false for every constructed `TermSelection`.
    pub fn is_empty(&self) -> bool {
        self.columns.is_empty()
    }

    /// Columns of the full row that are selected.
    pub(super) fn columns(&self) -> &[usize] {
        &self.columns
    }
}

impl Default for TermSelection {
    /// The 18 classical terms: permanent, induced and eddy.
    fn default() -> Self {
        let groups = vec![&GROUPS[0], &GROUPS[1], &GROUPS[4]];
        let columns = groups.iter().flat_map(|group| group.columns).copied().collect();
        Self { groups, columns }
    }
}

fn find(name: &str) -> Result<&'static TermGroup, AMatrixError> {
    GROUPS
        .iter()
        .find(|group| group.name == name || group.aliases.contains(&name))
        .ok_or_else(|| AMatrixError::Unknown { name: name.to_owned() })
}
