//! Profiles of the AWS command line: `AWS_PROFILE` in `~/.aws/credentials` and `~/.aws/config`.
//!
//! Reads access keys from these files, with the region and the endpoint. Credentials that a program must request
//! (single sign-on, roles, `credential_process`) are not read: `aws configure export-credentials --format env` prints
//! them as environment variables.

use std::{collections::HashMap, env, fs, io, path::PathBuf};

use object_store::aws::AmazonS3Builder;
use schemas::Fault;

/// Settings of a profile. They include secrets, and cannot be printed.
#[derive(Clone, Default)]
pub struct AwsProfile {
    name: String,
    access_key_id: Option<String>,
    secret_access_key: Option<String>,
    session_token: Option<String>,
    region: Option<String>,
    /// Address of the server.
    pub endpoint_url: Option<String>,
    /// Whether the profile refers to credentials that are not read here.
    other: bool,
}

fn set(name: &str) -> Option<String> {
    env::var(name).ok().filter(|v| !v.is_empty())
}

/// Keys of the section `name` of a file in the format of the AWS command line.
fn section(text: &str, name: &str) -> Option<HashMap<String, String>> {
    let mut found: Option<HashMap<String, String>> = None;
    let mut inside = false;
    for line in text.lines() {
        // An indented line belongs to a key with several values.
        if line.starts_with([' ', '\t', '#', ';']) {
            continue;
        }
        let line = line.trim();
        if let Some(head) = line.strip_prefix('[').and_then(|l| l.split(']').next()) {
            let head = head.trim();
            inside = head == name || head.strip_prefix("profile ").map(str::trim) == Some(name);
            if inside {
                found.get_or_insert_default();
            }
        } else if let (true, Some((key, value))) = (inside, line.split_once('=')) {
            found.get_or_insert_default().insert(key.trim().to_ascii_lowercase(), value.trim().to_owned());
        }
    }
    found
}

impl AwsProfile {
    /// Profile that the environment names, or `default` if it exists.
    ///
    /// # Errors
    /// Fails for a named profile that is missing, or for an unreadable file.
    pub fn chosen() -> Result<Option<AwsProfile>, Fault> {
        let named = set("AWS_PROFILE").or_else(|| set("AWS_DEFAULT_PROFILE"));
        let name = named.clone().unwrap_or_else(|| "default".to_owned());
        let home = || set("HOME").map(|home| PathBuf::from(home).join(".aws"));
        let file = |variable: &str, own: &str| set(variable).map(PathBuf::from).or_else(|| Some(home()?.join(own)));
        let files = [file("AWS_CONFIG_FILE", "config"), file("AWS_SHARED_CREDENTIALS_FILE", "credentials")];
        let mut texts = vec![];
        for path in files.into_iter().flatten() {
            match fs::read_to_string(&path) {
                Ok(text) => texts.push(text),
                Err(e) if e.kind() == io::ErrorKind::NotFound => {}
                Err(e) => return Err(Fault::machine(format!("cannot read {}: {e}", path.display()))),
            }
        }
        match (AwsProfile::from_texts(&texts, &name), named) {
            (None, Some(name)) => Err(Fault::machine(format!("there is no profile `{name}` (AWS_PROFILE)"))
                .help("add the profile to ~/.aws/credentials or ~/.aws/config")),
            (found, _) => Ok(found),
        }
    }

    /// Profile `name` in these texts; later texts take precedence over earlier texts.
    fn from_texts(texts: &[String], name: &str) -> Option<AwsProfile> {
        let mut all: Option<HashMap<String, String>> = None;
        for keys in texts.iter().filter_map(|text| section(text, name)) {
            all.get_or_insert_default().extend(keys);
        }
        let mut keys = all?;
        let other = ["sso_session", "sso_start_url", "role_arn", "credential_process", "credential_source"];
        Some(AwsProfile {
            name: name.to_owned(),
            other: other.iter().any(|key| keys.contains_key(*key)),
            access_key_id: keys.remove("aws_access_key_id"),
            secret_access_key: keys.remove("aws_secret_access_key"),
            session_token: keys.remove("aws_session_token"),
            region: keys.remove("region"),
            endpoint_url: keys.remove("endpoint_url"),
        })
    }

    /// Sets the values that the environment does not set.
    pub(super) fn into_builder(self, mut builder: AmazonS3Builder) -> Result<AmazonS3Builder, Fault> {
        if let (None, Some(id), Some(secret)) = (set("AWS_ACCESS_KEY_ID"), &self.access_key_id, &self.secret_access_key)
        {
            builder = builder.with_access_key_id(id).with_secret_access_key(secret);
            if let Some(token) = &self.session_token {
                builder = builder.with_token(token);
            }
        } else if self.other && self.access_key_id.is_none() && set("AWS_ACCESS_KEY_ID").is_none() {
            let what = format!("another program must request the credentials of the profile `{}`", self.name);
            return Err(Fault::machine(what).help(
                "put the credentials into the environment with `eval \"$(aws configure export-credentials --format \
                 env)\"`",
            ));
        }
        if let (None, None, Some(region)) = (set("AWS_REGION"), set("AWS_DEFAULT_REGION"), &self.region) {
            builder = builder.with_region(region);
        }
        Ok(builder)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn unit_profiles_are_parsed_like_the_aws_command_line() {
        let config = "[default]\nregion = eu-central-1\n\n[profile lab]\nregion=us-west-2\n\
                      s3 =\n  max_concurrent_requests = 5\nendpoint_url = http://x:1\n[profile sso]\nsso_session = a\n";
        let credentials = "# a remark\n[lab]\naws_access_key_id = ID\naws_secret_access_key = a=b/c\n[other]\n\
                           aws_access_key_id = NO\n";
        let texts = [config.to_owned(), credentials.to_owned()];
        let lab = AwsProfile::from_texts(&texts, "lab").unwrap();
        assert_eq!(lab.access_key_id.as_deref(), Some("ID"));
        assert_eq!(lab.secret_access_key.as_deref(), Some("a=b/c"));
        assert_eq!((lab.region.as_deref(), lab.endpoint_url.as_deref()), (Some("us-west-2"), Some("http://x:1")));
        assert!(AwsProfile::from_texts(&texts, "sso").unwrap().other && !lab.other);
        assert!(AwsProfile::from_texts(&texts, "none").is_none());
        assert_eq!(AwsProfile::from_texts(&texts, "default").unwrap().access_key_id, None);
    }
}
