//! What the model makes of messages.
