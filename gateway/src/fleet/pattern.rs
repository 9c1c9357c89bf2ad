//! Which names a key's name chunk means, by zenoh's own rules. Owns nothing; a chunk is a name or
//! wild (`*`, `cell-$*`), and whether it is wild is decided here only.

use zenoh::key_expr::keyexpr;

/// One chunk of a key: a name, or a wild chunk.
#[derive(Clone, Copy, Debug)]
pub enum Pattern<'p> {
    /// This name, which may be illegal.
    Name(&'p str),
    /// Every name that intersects.
    Wild(&'p keyexpr),
    /// `@LABEL`, which no chunk of a key can be: nodes with this label. It matches no name by itself.
    Label(&'p str),
    /// No chunk at all: it means no name.
    Malformed(&'p str),
}

impl<'p> Pattern<'p> {
    /// Reads the chunk.
    pub fn new(chunk: &'p str) -> Self {
        if let Some(label) = chunk.strip_prefix('@') {
            return Self::Label(label);
        }
        if !chunk.contains(['*', '$', '/', '#', '?']) && !chunk.is_empty() {
            return Self::Name(chunk);
        }
        match keyexpr::new(chunk) {
            // More than one chunk, by a slash or by `**`, is no name either, but `**` for one
            // chunk means what `*` means.
            Ok(wild) if !chunk.contains('/') => Self::Wild(wild),
            _ => Self::Malformed(chunk),
        }
    }

    /// Returns whether the name is meant.
    pub fn matches(&self, name: &str) -> bool {
        match self {
            Self::Name(this) => *this == name,
            Self::Wild(wild) => keyexpr::new(name).is_ok_and(|name| wild.intersects(name)),
            Self::Label(_) | Self::Malformed(_) => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chunk_means_what_zenoh_says_it_means() {
        for (chunk, name, expected) in [
            ("left", "left", true),
            ("left", "right", false),
            ("*", "left", true),
            ("**", "left", true),
            ("cell-a-$*", "cell-a-1", true),
            ("cell-a-$*", "cell-a-", true),
            ("cell-a-$*", "cell-b-1", false),
            ("$*-x", "a-x", true),
            ("a$*b$*c", "a1b2c", true),
            ("a*", "ab", false),
            ("", "left", false),
            ("a/b", "a", false),
            ("*/b", "a", false),
        ] {
            assert_eq!(
                Pattern::new(chunk).matches(name),
                expected,
                "{chunk} {name}"
            );
        }
    }
}
