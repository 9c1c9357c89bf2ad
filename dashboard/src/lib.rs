//! The operator's window on the fleet: what the fleet says goes in, what the operator asks comes out.
//!
//! ```text
//!            ┌───────── link (own thread, zenoh) ─────────┐
//!   zenoh ──▶│ callbacks ─▶ Inbox (bounded, latest wins)  │──▶ Model::apply ──▶ panels ──▶ screen
//!   zenoh ◀──│ perform   ◀─ bounded channel               │◀── Requests ◀────── panels ◀── operator
//!            └────────────────────────────────────────────┘
//!                     message::Message            model::Model         view::View
//! ```
//!
//! Open first: [`message`] (everything that can happen), [`model`] (everything that is known),
//! [`request`] (everything that can be asked for), [`app`] (who calls whom, once a frame).
//!
//! # Rules
//!
//! 1. **The model is pure.** [`Model::apply`](model::Model::apply) takes a message and the moment
//!    when it was heard. No egui, no zenoh, no clock, no file in `model/` and `message.rs`. Ages are
//!    computed from [`Model::now`](model::Model::now), which only moves by messages and
//!    [`Model::tick`](model::Model::tick): a test or a replay sees what the operator saw.
//! 2. **A panel is one function in one file**: `fn <noun>_ui(ui, &Model, &mut View, &mut Requests)`
//!    in `panels/<noun>.rs`. It reads the model, changes nothing but its own `<Noun>View`, and asks
//!    by pushing a [`Request`](request::Request). No zenoh, no channel, no blocking, no file.
//! 3. **What a panel remembers** (filter, sorting, text being typed) is a struct `<Noun>View` in the
//!    panel's file, a field of [`View`](view::View). What must survive a restart derives serde and is
//!    listed there; what must not is `#[serde(skip)]`.
//! 4. **What the operator asks for has a ticket.** [`Requests::push`](request::Requests::push) makes
//!    one; every answer comes back as [`Message::Answer`](message::Message::Answer) with it. The
//!    effect on nodes is never taken from the answer but from what the nodes say themselves.
//! 5. **A new thing heard from the fleet** is: a variant of `Message`, its place in the
//!    [`Inbox`](link::inbox::Inbox) with a bound and an answer to “full”, a callback in
//!    `link/session.rs`, an arm in `Model::apply`, a test in `model/`. Messages derive serde, so that
//!    a session can be recorded and replayed as the list of what was heard.
//! 6. **A new thing to ask for** is: a variant of `Request`, an arm in `link/perform.rs`, the button.
//! 7. **Records and commands are those of `keys`.** Nothing is declared a second time. The gateway is
//!    never imported; a test that needs one lives in the crate `tests`.
//! 8. **Colour never alone carries meaning**: states have an icon and a word, both from [`theme`],
//!    the only file that names colours. Everything that can be clicked has a name that a screen
//!    reader says and a test clicks ([`theme::named`] gives one to what has none by itself).
//! 9. **Typing never triggers anything.** Keys that act are in [`keyboard`], one table, and none of
//!    them is a plain character while a text field has the focus.
//! 10. **Long lists draw only the rows in sight** and have a bound in the model
//!     ([`model::limits`]).
//! 11. **Files are read and written by [`files`]**, on threads of their own, with bounds, and never
//!     over one that exists. A panel says what it wants in its view.
//! 12. **The past is never taken for the present**: while a [`recording`] is shown its bar says so,
//!     what is above the bar is live, and no request but STOP ALL leaves
//!     ([`Session::lets_out`](recording::session::Session::lets_out)).

pub mod app;
pub mod credentials;
pub mod estimate;
pub mod export;
pub mod files;
pub mod keyboard;
pub mod link;
pub mod lua;
pub mod message;
pub mod model;
pub mod panels;
pub mod recording;
pub mod records;
pub mod request;
pub mod sound;
pub mod syntax;
pub mod text;
pub mod theme;
pub mod view;
