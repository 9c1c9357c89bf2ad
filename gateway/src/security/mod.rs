//! A secured fleet: who may connect, and what each may say and hear.
//!
//! ```text
//!   fleet init DIR      ──▶ DIR/ca.pem, ca.key          the fleet's own authority
//!   fleet users DIR add ──▶ DIR/router.pem, router.key  the router's certificate
//!                           DIR/users                   NAME:ROLE:PASSWORD, a line each
//!                           DIR/NAME.json               credentials to hand to NAME
//!   fleet serve --secure DIR ─ reads all of it ─▶ TLS, passwords and access rules of the router
//! ```
//!
//! Everything is denied but what a [`Role`] allows: see [`access`]. The folder and every file with a
//! secret are readable by their owner only; [`Home::open`] refuses them otherwise.
//!
//! Users, rules and signing keys are read when the gateway starts: who is added or revoked counts
//! from its next start.
//!
//! # Threat model
//!
//! To be protected, in this order: people at the machines; the machines and what they make; the truth
//! of the records; the jobs themselves, which may be somebody's secret.
//!
//! | who attacks | what stands in the way | test | what is left |
//! |---|---|---|---|
//! | somebody in the network, without a password | an unsecured gateway listens on its own machine only and says so; a secured one lets in by password, people by TLS with the fleet's own authority | `nobody_gets_in_without_the_right_password…`, `a_person_who_comes_without_tls…` | can open connections until the system has no more; can listen to and change what nodes say and hear over plain TCP, unless they speak TLS, see below |
//! | a viewer | rules of the router: may look on and stop, and what is larger than its kind of message is passed on to nobody; stops of a flood wait as one | `a_viewer_looks_on_and_stops…`, `a_key_that_only_includes_stops…`, `whoever_calls_himself_a_peer…`, `what_is_too_large…`, `a_flood_of_stops…` | can stop everything all the time: a stop is never refused |
//! | a node that was taken over | rules by the name under which it authenticated: its own keys only | `a_node_cannot_speak_as_another…` | can lie about itself; can be heard 2,000 times a second ([`limits`](crate::bus::limits)), 4 KiB each ([`sizes`](crate::bus::sizes)); like every link it can have the router hold memory, see below |
//! | an operator's client that runs wild | bounds by link on requests, bytes and open gets; a job's size; jobs for one node; commands and scripts of all jobs; the text of a refusal | `a_client_that_floods…`, `scripts_that_wait…`, `a_refusal_keeps_no_more…`, `a_job_that_is_too_large…`, `no_list_grows_without_bound`, `refused_jobs_do_not_push_out…` | behind a router of others all its clients count as one; one that connects anew begins with a full account; a stop is not counted |
//! | whoever has the router or the gateway, or sits between them and a node | signed jobs: the node executes exactly the commands or the script that an operator's key has signed, for this node, in this life of it, once | `node/tests/signed.rs`, `what_an_operator_signed_is_executed_once…` | can withhold, delay and cut off, stop, cancel, release, hold, resume, change the speed within what the node allows, and choose when a job begins; can tell clients anything: records are not signed |
//! | whoever has an operator's key or password | `fleet keys revoke`, `fleet users revoke`; both count from the next start; private halves are files that nobody else may read, and never on a command line | `a_secret_that_others_may_read_is_refused`, `who_was_revoked…`, `a_fleet_that_signs_goes_on_asking…` | until then everything that the operator could |
//! | whoever has the gateway's disk | – | – | everything but the operators' signing keys, if those were handed out and removed |
//! | whoever has a node in hand | – | – | its password and, if it is not encrypted, its flash |
//! | a crate that we build on | versions are locked; licences, sources and `unsafe` are checked by `tests/tests/supply.rs`; withdrawn versions by `.ci/yanked`, advisories by `.ci/advisories` where the network is | `tests/tests/supply.rs` | what nobody has found yet |
//!
//! **Signed jobs** are described in [`keys::signed`]. Why the life of the node is signed and no date:
//! a node has no calendar, and one that believed its gateway's would believe an attacker's. A job that
//! was signed before a reboot must be signed again. A script to be stored is signed too, by itself
//! ([`keys::signed_script`]): a node that asks for signatures takes it with that only, and calls it by a
//! signed job; taking one away is a signed empty text. A part of a synchronized job is signed with its
//! meeting points; the instants at which it passes them are not. Within one life of a node a key's number
//! is used once; of each key the last 16 are remembered and older ones refused.
//!
//! **TLS on a node** (`node-firmware/tls`): a node that was told the fleet's authority (`fleet provision
//! --router tls/… --ca DIR/ca.pem`, `emulator --ca`) speaks TLS 1.3 to port 7447, with its password
//! inside, and to nobody whose certificate that authority has not signed for the name under which the
//! node reaches it; it never falls back to plain TCP, whatever its address, a scout or a router says.
//! Without an authority it proves itself by a password that is never sent, and what it says by plain TCP
//! can be read and changed on the way, except that a signed job cannot be changed. `--listen
//! tls/0.0.0.0:7447` alone closes the door for nodes without TLS. Left: a node has no calendar and does
//! not check dates, so the key of a router's certificate counts until nodes are told another authority;
//! there is no revocation list; whoever listens still sees when and how much a node says. The library is
//! rustls, the router's own, without I/O: no read is lost when it is dropped, addresses are checked as
//! names are, and 4.4 KB of heap open a link and 2.4 KB keep it. What it costs is flash: 270 KB of code and
//! constants (riscv32imac, optimized for size). `embedded-tls` 0.19, tried before, takes half of that, but
//! 16 KiB of memory for its longest record, knows no addresses, and its reads must not be dropped.
//!
//! **Clocks.** Certificates are good for twenty years, so that a clock which is wrong by months does
//! not stop a fleet; nothing else here asks what day it is.
//!
//! **Epochs** ([`keys::epoch`]) keep a gateway that was replaced from moving anything; they are no
//! defence against one that lies. Whoever may give orders to a node can say the highest epoch, and no
//! honest gateway is obeyed until that node boots. A node can make nobody resign: its record says that
//! it obeys another gateway, and the others are served. Only who may be a gateway can declare an
//! owner's token.
//!
//! **Memory.** Before the router looks at a message it puts it together from fragments, and what is too
//! large for its key is dropped only then. Zenoh bounds that for each lane of a link (eight priorities,
//! reliable and not) by one number for all links, `transport/link/rx/max_message_size`: here
//! [`MESSAGE_BYTES_MAX`](crate::config::MESSAGE_BYTES_MAX), 65 MiB, because a job may have 64
//! (`fragments_without_an_end…`). So one link can have 1 GiB of it, and all that are let in (`nodes` of
//! `fleet.toml` and [`CLIENTS_MAX`](crate::config::CLIENTS_MAX)) more than any machine has. Worse, zenoh
//! 1.10.2 keeps every fragment in the batch in which it came: pieces of one byte take 8 to 64 KiB
//! each (`PIECE=1 PIECES=5000 cargo test -p tests --test fragments -- --nocapture`), however little that is
//! of the 65 MiB. Whoever has a password can therefore end a gateway. The bound of the whole is the process's: `gateway/debian/stepfleet.service`
//! gives it three quarters of the machine's memory and starts it again; nodes have stopped by themselves
//! by then, and the store has what was accepted.
//!
//! **Denial.** A fleet in a network that somebody else owns can be kept from working. It cannot be
//! kept from stopping: a node that loses its link stops by itself, and a stop pin needs no network.

pub mod access;
mod certificates;
pub mod home;
pub mod signing;
pub mod users;

pub use home::{Home, HomeError};
pub use users::{Role, User};
