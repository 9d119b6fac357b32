//! Groups of parameters in tables within a table, and in lists of tables.

use crate::{
    ChoiceRegistry, Fault, Literal, Param, ParamDoc, ParamReader, ParamValue, Params, Rule, SpecEntry, SpecSection,
};

/// Group of parameters in a nested table. An absent table equals a table without keys.
#[derive(Clone, Debug, PartialEq)]
pub struct NestedParams<T>(pub T);

/// Groups of parameters in a list of tables.
#[derive(Clone, Debug, PartialEq)]
pub struct ParamsList<T>(pub Vec<T>);

impl<T> From<T> for NestedParams<T> {
    fn from(group: T) -> Self {
        Self(group)
    }
}

impl<T> From<Vec<T>> for ParamsList<T> {
    fn from(groups: Vec<T>) -> Self {
        Self(groups)
    }
}

fn spelt<T: Params>(group: &T) -> String {
    let mut pairs = vec![];
    group.spell(&mut pairs);
    format!("{{{}}}", pairs.iter().map(|(key, value)| format!("{key}={value}")).collect::<Vec<_>>().join(","))
}

impl<T: Params> ParamValue for NestedParams<T> {
    const TYPE: &'static str = "table";

    fn read(_: &Literal) -> Option<Self> {
        None
    }

    fn check(&self, _: &Rule) -> Result<(), Fault> {
        Ok(())
    }

    fn canonical(&self) -> String {
        spelt(&self.0)
    }

    fn obtain(reader: &mut ParamReader, param: Param<Self>) -> Option<Self> {
        let base = param.absent.as_ref().map(|nested| &nested.0);
        match reader.given(param.name) {
            None => reader.inside(param.name, &SpecSection::default(), base).map(NestedParams),
            Some(SpecEntry { value: Literal::Section(section), .. }) => {
                reader.inside(param.name, section, base).map(NestedParams)
            }
            Some(given) => {
                reader.wrong_type(param.name, Self::TYPE, given);
                None
            }
        }
    }

    fn document(doc: ParamDoc, lists: &ChoiceRegistry) -> Vec<ParamDoc> {
        let absent = doc.absent.filter(|text| !text.is_empty()).or(Some("a table without keys"));
        vec![ParamDoc { keys: T::docs(lists), default: None, absent, ..doc }]
    }
}

impl<T: Params> ParamValue for ParamsList<T> {
    const TYPE: &'static str = "list of tables";

    fn read(_: &Literal) -> Option<Self> {
        None
    }

    fn check(&self, _: &Rule) -> Result<(), Fault> {
        Ok(())
    }

    fn canonical(&self) -> String {
        format!("[{}]", self.0.iter().map(spelt).collect::<Vec<_>>().join(","))
    }

    fn obtain(reader: &mut ParamReader, param: Param<Self>) -> Option<Self> {
        let Some(given) = reader.given(param.name) else {
            if param.absent.is_none() {
                reader.missing(param.name, param.doc);
            }
            return param.absent;
        };
        let items = match &given.value {
            Literal::List(items) => items.as_slice(),
            one => std::slice::from_ref(one),
        };
        let mut groups = vec![];
        for item in items {
            match item {
                Literal::Section(section) => groups.push(reader.inside(param.name, section, None)),
                _ => {
                    reader.wrong_type(param.name, Self::TYPE, given);
                    return None;
                }
            }
        }
        groups.into_iter().collect::<Option<Vec<T>>>().map(ParamsList)
    }

    fn document(doc: ParamDoc, lists: &ChoiceRegistry) -> Vec<ParamDoc> {
        vec![ParamDoc { keys: T::docs(lists), ..doc }]
    }
}
