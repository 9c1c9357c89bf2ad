//! What can be typed about a node's firmware.

use super::parse::node_id;
use clap::Args;
use keys::NodeId;
use std::path::PathBuf;

#[derive(Debug, Args)]
pub(crate) struct Update {
    /// The node.
    #[arg(value_parser = node_id)]
    pub(crate) node: NodeId,

    /// Image, as `espflash save-image` makes it.
    #[arg(requires = "key")]
    pub(crate) image: Option<PathBuf>,

    /// File with the key that signs it. Nobody but you may be able to read it.
    #[arg(long, value_name = "FILE")]
    pub(crate) key: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub(crate) struct UpdateKey {
    /// File of the key; the one for nodes is beside it and ends in .pub.
    pub(crate) file: PathBuf,
}
