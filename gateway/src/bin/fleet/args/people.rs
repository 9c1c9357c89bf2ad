//! What can be typed about a secured fleet: its users and their keys.

use super::parse::node_id;
use clap::{Args, Subcommand};
use keys::NodeId;
use std::path::PathBuf;

#[derive(Debug, Args)]
pub(crate) struct Init {
    /// Where; made if it is not there, and readable by you only.
    #[arg(value_name = "DIR")]
    pub(crate) folder: PathBuf,

    /// Name or address under which clients and nodes reach the gateway's machine; may be given
    /// several times. `localhost` is always one.
    #[arg(long = "host", value_name = "NAME")]
    pub(crate) hosts: Vec<String>,

    /// The first operator.
    #[arg(long, value_name = "NAME", default_value = "operator", value_parser = node_id)]
    pub(crate) operator: NodeId,
}

#[derive(Debug, Args)]
pub(crate) struct Users {
    /// Folder of the fleet.
    #[arg(value_name = "DIR")]
    pub(crate) folder: PathBuf,

    #[command(subcommand)]
    pub(crate) act: UsersAct,
}

/// What to do with users. All of it counts from the gateway's next start.
#[derive(Debug, Subcommand)]
pub(crate) enum UsersAct {
    /// Add one, and write the credentials to hand out to DIR/NAME.json.
    Add {
        /// Name; a node's is its own.
        #[arg(value_parser = node_id)]
        name: NodeId,
        /// `operator` hands in, cancels, stops and releases; `viewer` looks on and stops; `node` is
        /// the node of that name.
        #[arg(long)]
        role: gateway::security::Role,
    },
    /// Take one away.
    Revoke {
        /// Name.
        #[arg(value_parser = node_id)]
        name: NodeId,
    },
    /// List them.
    List,
}

#[derive(Debug, Args)]
pub(crate) struct Keys {
    /// Folder of the fleet.
    #[arg(value_name = "DIR")]
    pub(crate) folder: PathBuf,

    #[command(subcommand)]
    pub(crate) act: KeysAct,
}

/// What to do with signing keys. All of it counts from the next start of gateway and nodes.
#[derive(Debug, Subcommand)]
pub(crate) enum KeysAct {
    /// Make one, and write the private half to hand out to DIR/NAME.key.
    New {
        /// Whose.
        #[arg(value_parser = node_id)]
        name: NodeId,
    },
    /// Take one away.
    Revoke {
        /// Whose.
        #[arg(value_parser = node_id)]
        name: NodeId,
    },
    /// List the public halves.
    List,
    /// Let jobs without a signature in again. Revoking the last key does not.
    Off,
}
