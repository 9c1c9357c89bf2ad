//! Who may connect: names, roles and passwords, a line each.

use keys::NodeId;
use std::{fmt, str::FromStr};

/// The user as which the gateway speaks to its own router.
pub const GATEWAY: &str = "gateway";

/// Length of a made password: 130 bits of 26 symbols.
const PASSWORD_CHARS: usize = 28;

/// What somebody may do. A stop is for everybody who may look on; whatever moves is not.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// The gateway itself.
    Gateway,
    /// Hands in, cancels, stops and releases.
    Operator,
    /// Looks on, and stops.
    Viewer,
    /// The node of the same name: hears and says what concerns that node.
    Node,
}

impl Role {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Gateway, Self::Operator, Self::Viewer, Self::Node];

    /// Returns the word in the file and on the command line.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Gateway => "gateway",
            Self::Operator => "operator",
            Self::Viewer => "viewer",
            Self::Node => "node",
        }
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl FromStr for Role {
    type Err = String;
    fn from_str(word: &str) -> Result<Self, String> {
        let mut all = Self::ALL.into_iter();
        all.find(|role| role.as_str() == word)
            .ok_or_else(|| format!("{word:?} is no role: operator, viewer or node"))
    }
}

/// One line of the users file.
#[derive(Clone, PartialEq, Eq)]
pub struct User {
    /// The name; of a node the node's own.
    pub name: NodeId,
    /// What it may do.
    pub role: Role,
    /// The password.
    pub password: String,
}

impl fmt::Debug for User {
    /// Leaves the password out.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({})", self.name, self.role)
    }
}

impl User {
    /// Makes a user with a random password.
    ///
    /// # Errors
    /// The system has no random numbers.
    pub fn new(name: NodeId, role: Role) -> Result<Self, getrandom::Error> {
        // 26 letters without a vowel, l, 0 or 1: nothing that is misread, no word by accident.
        const SYMBOLS: &[u8; 26] = b"bcdfghjkmnpqrstvwxyz234567";
        let mut password = String::with_capacity(PASSWORD_CHARS);
        while password.len() < PASSWORD_CHARS {
            let mut bytes = [0; 64];
            getrandom::getrandom(&mut bytes)?;
            // 234 is the largest multiple of 26 in a byte: each symbol is as likely as any other.
            let fair = bytes.iter().filter(|byte| **byte < 234);
            let symbols = fair.map(|byte| char::from(SYMBOLS[usize::from(*byte) % 26]));
            password.extend(symbols.take(PASSWORD_CHARS - password.len()));
        }
        Ok(Self {
            name,
            role,
            password,
        })
    }
}

/// Reads the users file.
///
/// # Errors
/// The line and what is wrong with it; passwords are not in the text.
pub fn parse(text: &str) -> Result<Vec<User>, String> {
    let mut users: Vec<User> = Vec::new();
    for (number, line) in (1..).zip(text.lines()) {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let bad = |what: &str| format!("line {number}: {what}");
        let mut parts = line.splitn(3, ':');
        let (Some(name), Some(role), Some(password)) = (parts.next(), parts.next(), parts.next())
        else {
            return Err(bad("not of the form NAME:ROLE:PASSWORD"));
        };
        let name = NodeId::new(name).map_err(|error| bad(&format!("{name:?}: {error}")))?;
        let role: Role = role.parse().map_err(|error: String| bad(&error))?;
        if password.is_empty() {
            return Err(bad("the password is empty"));
        }
        if users.iter().any(|user| user.name == name) {
            return Err(bad(&format!("{name} is there already")));
        }
        users.push(User {
            name,
            role,
            password: password.to_owned(),
        });
    }
    Ok(users)
}

/// Returns the text of the users file.
pub fn print(users: &[User]) -> String {
    let mut text = String::from(
        "# Who may connect: NAME:ROLE:PASSWORD. Kept by `fleet users`; read when the gateway starts.\n",
    );
    for user in users {
        let User {
            name,
            role,
            password,
        } = user;
        text.push_str(&format!("{name}:{role}:{password}\n"));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn user(name: &str, role: Role) -> User {
        User::new(NodeId::new(name).expect("legal"), role).expect("random numbers")
    }

    #[test]
    fn what_is_printed_is_read() {
        let users = vec![
            user("gateway", Role::Gateway),
            user("alice", Role::Operator),
            user("left", Role::Node),
        ];
        assert_eq!(parse(&print(&users)), Ok(users));
    }

    #[test]
    fn passwords_are_long_and_differ() {
        let (a, b) = (user("a", Role::Viewer), user("b", Role::Viewer));
        assert_eq!(a.password.len(), PASSWORD_CHARS);
        assert_ne!(a.password, b.password);
        assert!(!format!("{a:?}").contains(&a.password));
    }

    #[test]
    fn an_error_names_the_line_and_no_password() {
        for (text, words) in [
            ("a:operator", "line 1: not of the form"),
            ("\n# x\nA:operator:hush", "line 3: \"A\""),
            ("a:boss:hush", "line 1: \"boss\" is no role"),
            ("a:viewer:hush\na:node:hush", "line 2: a is there already"),
            ("a:viewer:", "line 1: the password is empty"),
        ] {
            let error = parse(text).expect_err("illegal");
            assert!(error.contains(words), "{text:?}: {error}");
            assert!(!error.contains("hush"), "{error}");
        }
    }
}
