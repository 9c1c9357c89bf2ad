//! A client's way into a secured fleet: where, as whom, and whose certificates to trust.
//!
//! Written by `fleet init` and `fleet users`, read by the command line and the dashboard. The file
//! holds a password: whoever reads it must refuse one that others may read.

use base64::Engine as _;
use serde::{Deserialize, Serialize};
use std::{
    fmt, format,
    string::{String, ToString},
    vec,
    vec::Vec,
};

/// The content of a credentials file, JSON.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Credentials {
    /// Where the router is, `tls/HOST:PORT` or `tcp/HOST:PORT`; any of them will do.
    pub connect: Vec<String>,
    /// The name.
    pub user: String,
    /// The password.
    pub password: String,
    /// The certificate of the fleet's own authority, PEM: the only one that is trusted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ca: Option<String>,
}

impl Credentials {
    /// Reads the content of a file.
    ///
    /// # Errors
    /// What is wrong and where. The text holds nothing of the file's content.
    pub fn from_json(text: &str) -> Result<Self, String> {
        let read: Self = serde_json::from_str(text).map_err(|error| {
            // Serde quotes what it found, and that may be a password.
            let (line, column) = (error.line(), error.column());
            format!("no credentials: line {line}, column {column}")
        })?;
        if read.connect.is_empty() {
            return Err("connect: no address".into());
        }
        if read.user.is_empty() || read.password.is_empty() {
            return Err("user and password must not be empty".into());
        }
        Ok(read)
    }

    /// Returns the content of a file.
    pub fn to_json(&self) -> String {
        let mut text = serde_json::to_string_pretty(self).expect("texts and lists are JSON");
        text.push('\n');
        text
    }

    /// Returns what a zenoh client has to set to connect as this user and to trust nobody else:
    /// the name of each setting and its value as JSON. Where to connect is not among it. The values
    /// are secrets: an error about one must not quote it.
    pub fn zenoh_settings(&self) -> Vec<(&'static str, String)> {
        let text = |value: &str| serde_json::Value::from(value).to_string();
        let mut settings = vec![
            ("transport/auth/usrpwd/user", text(&self.user)),
            ("transport/auth/usrpwd/password", text(&self.password)),
        ];
        if let Some(ca) = &self.ca {
            let ca = base64::prelude::BASE64_STANDARD.encode(ca);
            settings.push(("transport/link/tls/root_ca_certificate_base64", text(&ca)));
        }
        settings
    }
}

impl fmt::Debug for Credentials {
    /// Leaves the password out.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Credentials")
            .field("connect", &self.connect)
            .field("user", &self.user)
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn alice() -> Credentials {
        Credentials {
            connect: vec!["tls/plant:7447".into()],
            user: "alice".into(),
            password: "hush".into(),
            ca: Some("-----BEGIN CERTIFICATE-----\n".into()),
        }
    }

    #[test]
    fn what_is_written_is_read() {
        assert_eq!(Credentials::from_json(&alice().to_json()), Ok(alice()));
    }

    #[test]
    fn a_client_is_told_user_password_and_authority_and_no_address() {
        let names = |credentials: &Credentials| -> Vec<&str> {
            let settings = credentials.zenoh_settings().into_iter();
            settings.map(|(name, _)| name).collect()
        };
        let mut alice = alice();
        assert_eq!(names(&alice).len(), 3);
        assert_eq!(alice.zenoh_settings()[1].1, "\"hush\"");
        alice.ca = None;
        assert_eq!(names(&alice).len(), 2);
    }

    #[test]
    fn an_error_names_the_place_and_no_password() {
        let text = alice().to_json().replace("\"hush\"", "[\"hush\"]");
        let error = Credentials::from_json(&text).expect_err("no password");
        assert!(
            error.contains("line 6") && !error.contains("hush"),
            "{error}"
        );
        assert!(!format!("{:?}", alice()).contains("hush"));
    }

    #[test]
    fn an_empty_password_is_none() {
        let text = alice().to_json().replace("hush", "");
        assert!(Credentials::from_json(&text).is_err());
    }
}
