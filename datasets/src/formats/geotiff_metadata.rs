//! GDAL's metadata in a GeoTIFF: an XML text of items, some of which describe the band. [GDAL, "GTiff driver", tag
//! 42112]

use std::path::Path;

use crate::{ReadError, grid::PLAIN};

/// The items of the file and of its first band.
#[derive(Debug)]
pub(super) struct GdalMetadata<'a> {
    path: &'a Path,
    items: Vec<GdalMetadataItem>,
}

#[derive(Debug)]
struct GdalMetadataItem {
    name: String,
    /// The band, from 0; `None` for an item of the whole file.
    sample: Option<u16>,
    role: String,
    text: String,
}

impl<'a> GdalMetadata<'a> {
    /// Reads the text of the tag.
    ///
    /// # Errors
    /// Fails for an item without an end, or for a band index that is not a whole number.
    pub(super) fn read(path: &'a Path, xml: &str) -> Result<GdalMetadata<'a>, ReadError> {
        let broken = |what: &str| {
            ReadError::data(path, format!("GDAL's metadata (tag 42112) {what}"))
                .help("repair the tag, for example with `gdal_translate`")
        };
        let mut items = vec![];
        for part in xml.split("<Item").skip(1) {
            let (head, rest) = part.split_once('>').ok_or_else(|| broken("is truncated"))?;
            let attribute = |name: &str| {
                let (_, rest) = head.split_once(&format!(" {name}="))?;
                let quote = rest.chars().next().filter(|c| ['"', '\''].contains(c))?;
                rest.get(1..)?.split(quote).next().map(unescaped)
            };
            let text = if head.ends_with('/') { "" } else { rest.split('<').next().unwrap_or_default() };
            let sample = attribute("sample").map(|s| s.trim().parse::<u16>());
            items.push(GdalMetadataItem {
                name: attribute("name").unwrap_or_default(),
                sample: sample.transpose().map_err(|_| broken("has a band index that is not a whole number"))?,
                role: attribute("role").unwrap_or_default(),
                text: unescaped(text.trim()),
            });
        }
        Ok(GdalMetadata { path, items })
    }

    /// The first of `names` for which the file or its first band has an item, and the text of this item.
    pub(super) fn item<'n>(&self, names: &[&'n str]) -> Option<(&'n str, &str)> {
        let of = |name: &&'n str| {
            let mut found = self.items.iter().filter(|i| i.name == *name && i.sample.is_none_or(|s| s == 0));
            let text = found.find(|i| !i.text.is_empty())?;
            Some((*name, text.text.as_str()))
        };
        names.iter().find_map(of)
    }

    /// Scale and offset of the first band.
    ///
    /// # Errors
    /// Fails for a scale or offset that is not a number, is given twice, or lacks the attribute `sample` or `role`.
    pub(super) fn packing(&self) -> Result<[f64; 2], ReadError> {
        let mut packing = PLAIN;
        for (value, role) in packing.iter_mut().zip(["scale", "offset"]) {
            let meant =
                |i: &&GdalMetadataItem| i.role == role || i.role.is_empty() && i.name == role.to_ascii_uppercase();
            let mut found = self.items.iter().filter(meant).filter(|i| i.sample.is_none_or(|s| s == 0));
            let Some(item) = found.next() else { continue };
            let wrong = |what: String| {
                let help = "correct the tag, or unpack the file with `gdal_translate -unscale -ot Float64`";
                Err(ReadError::data(self.path, format!("the {role} of the band (tag 42112) {what}")).help(help))
            };
            if item.sample.is_none() || item.role.is_empty() {
                return wrong("lacks the attribute `sample` or `role`".to_owned());
            }
            if found.next().is_some() {
                return wrong("is given twice".to_owned());
            }
            match item.text.parse::<f64>().ok().filter(|x| x.is_finite() && (role == "offset" || *x != 0.0)) {
                Some(number) => *value = number,
                None => return wrong(format!("must be a valid number, not `{}`", item.text)),
            }
        }
        Ok(packing)
    }
}

fn unescaped(text: &str) -> String {
    let entities = [("&lt;", "<"), ("&gt;", ">"), ("&quot;", "\""), ("&apos;", "'"), ("&amp;", "&")];
    entities.iter().fold(text.to_owned(), |text, (from, to)| text.replace(from, to))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn packing(items: &str) -> Result<[f64; 2], String> {
        let xml = format!("<GDALMetadata>\n{items}\n</GDALMetadata>");
        let metadata = GdalMetadata::read(Path::new("m.tif"), &xml).map_err(|e| e.to_string())?;
        metadata.packing().map_err(|e| e.to_string())
    }

    #[test]
    fn ref_scale_and_offset_of_the_first_band() {
        let scale = r#"<Item name="SCALE" sample="0" role="scale">0.05</Item>"#;
        let offset = r#"<Item name='OFFSET' sample='0' role='offset'>-50</Item>"#;
        assert_eq!(packing(&format!("{scale}{offset}")), Ok([0.05, -50.0]));
        assert_eq!((packing(scale), packing(offset)), (Ok([0.05, 0.0]), Ok([1.0, -50.0])));
        assert_eq!(packing(&scale.replace("sample=\"0\"", "sample=\"1\"")), Ok(PLAIN), "of another band");
        assert_eq!(packing("<Item name=\"scale\">1:50000</Item>"), Ok(PLAIN), "of the paper");
    }

    #[test]
    fn gold_broken_or_partial_entries() {
        let entry = |sample: &str, role: &str, text: &str| format!("<Item name=\"SCALE\"{sample}{role}>{text}</Item>");
        let (sample, role) = (" sample=\"0\"", " role=\"scale\"");
        for (items, what) in [
            (entry(sample, role, "0,05"), "must be a valid number, not `0,05`"),
            (entry(sample, role, ""), "must be a valid number, not ``"),
            (entry(sample, role, "0"), "must be a valid number, not `0`"),
            (entry(sample, role, "nan"), "must be a valid number, not `nan`"),
            (entry("", role, "2"), "lacks the attribute `sample` or `role`"),
            (entry(sample, "", "2"), "lacks the attribute `sample` or `role`"),
            (entry(sample, role, "2").repeat(2), "is given twice"),
            (entry(" sample=\"a\"", role, "2"), "has a band index that is not a whole number"),
            ("<Item name=\"SCALE\" sample=\"0\"".to_owned(), "lacks the attribute `sample` or `role`"),
        ] {
            let fault = packing(&items).unwrap_err();
            assert!(fault.contains(what), "{items}: {fault}");
        }
    }
}
