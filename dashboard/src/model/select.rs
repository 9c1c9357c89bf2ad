//! Which nodes a key chunk means: `node-1`, `*`, `cell-a-$*`.

use zenoh_keyexpr::{OwnedKeyExpr, keyexpr};

/// A chunk of a key expression that names nodes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pattern(OwnedKeyExpr);

impl Pattern {
    /// Reads what an operator types.
    ///
    /// # Errors
    /// It is no single chunk of a key expression; the words say what is wrong.
    pub fn new(chunk: &str) -> Result<Self, String> {
        if chunk.is_empty() {
            return Err("name a node, or several: * or cell-a-$*".to_owned());
        }
        if chunk.contains('/') || chunk == "**" {
            return Err("one chunk without /".to_owned());
        }
        if chunk.contains('*') && chunk != "*" && !chunk.contains("$*") {
            return Err(format!(
                "inside a name write $* for “anything”: {}",
                chunk.replace('*', "$*")
            ));
        }
        let words = "not a key expression: a-z, 0-9, _, -, * and $* only";
        // Zenoh allows more in a chunk; no node is called so.
        let known = |c: char| matches!(c, 'a'..='z' | '0'..='9' | '_' | '-' | '*' | '$');
        if !chunk.chars().all(known) {
            return Err(words.to_owned());
        }
        let expression = OwnedKeyExpr::autocanonize(chunk.to_owned());
        expression.map(Self).map_err(|_| words.to_owned())
    }

    /// Returns the chunk in canonical form.
    pub fn as_str(&self) -> &str {
        self.0.as_str()
    }

    /// Returns whether it may mean several nodes.
    pub fn is_wild(&self) -> bool {
        self.0.is_wild()
    }

    /// Returns whether it means this node.
    pub fn matches(&self, node: &str) -> bool {
        keyexpr::new(node).is_ok_and(|node| self.0.intersects(node))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pattern_means_what_the_router_would_deliver_to() {
        let matches =
            |pattern: &str, node: &str| Pattern::new(pattern).expect("a pattern").matches(node);
        assert!(matches("*", "left"));
        assert!(matches("cell-a-$*", "cell-a-7"));
        assert!(!matches("cell-a-$*", "cell-b-7"));
        assert!(matches("left", "left"));
        assert!(!matches("left", "left-2"));
        assert!(matches("$*-x", "node-x"));
    }

    #[test]
    fn what_cannot_be_a_chunk_is_refused_with_advice() {
        let refused = |text: &str| Pattern::new(text).expect_err("no pattern");
        assert_eq!(
            refused("cell-*"),
            "inside a name write $* for “anything”: cell-$*"
        );
        assert!(refused("").contains("cell-a-$*"));
        assert!(refused("a/b").contains('/'));
        assert!(refused("**").contains("chunk"));
        assert!(refused("a#b").contains("key expression"));
        assert!(refused("2 selected nodes").contains("key expression"));
        assert!(refused("Left").contains("a-z"));
    }
}
