//! What the application says: declarations, publications, questions, answers.
//!
//! Declarations work at any time and are told whenever there is a connection. Everything else
//! needs an open session and room in the queue, and says so if it has not.

use super::{Link, Session};
use crate::{
    declarations::{Kind, check_key, lane},
    event::{
        DeclareError, Encoding, GetError, GetOptions, InboundQuery, KeyId, KeyRef, LivelinessId,
        PublisherId, PutError, PutOptions, QueryId, QueryableId, ReplyError, SampleKind,
        SubscriberId, TokenId, UndeclareError,
    },
    limits,
    queries::QueryOut,
    wire::network::{self, WireKey},
};

impl Session {
    /// Declares a key expression, so that it costs two bytes in every message.
    ///
    /// # Errors
    /// [`DeclareError`]; nothing is declared then. The same holds for all `declare_…`.
    pub fn declare_key(&mut self, key: &str) -> Result<KeyId, DeclareError> {
        self.declare(Kind::Key, key).map(KeyId)
    }

    /// Subscribes to all keys that meet `key`.
    ///
    /// # Errors
    /// As [`Session::declare_key`].
    pub fn declare_subscriber(&mut self, key: &str) -> Result<SubscriberId, DeclareError> {
        self.declare(Kind::Subscriber, key).map(SubscriberId)
    }

    /// Offers to answer questions about keys that meet `key`. Complete means that it knows all
    /// there is to know under `key`.
    ///
    /// # Errors
    /// As [`Session::declare_key`].
    pub fn declare_queryable(
        &mut self,
        key: &str,
        complete: bool,
    ) -> Result<QueryableId, DeclareError> {
        self.declare(Kind::Queryable { complete }, key)
            .map(QueryableId)
    }

    /// Announces that `key` will be published on, and asks who wants it.
    ///
    /// # Errors
    /// As [`Session::declare_key`].
    pub fn declare_publisher(&mut self, key: &str) -> Result<PublisherId, DeclareError> {
        self.declare(
            Kind::Publisher {
                answered: false,
                wanted: false,
            },
            key,
        )
        .map(PublisherId)
    }

    /// Puts up a sign of life that vanishes with this session's connection.
    ///
    /// # Errors
    /// As [`Session::declare_key`].
    pub fn declare_token(&mut self, key: &str) -> Result<TokenId, DeclareError> {
        self.declare(Kind::Token, key).map(TokenId)
    }

    /// Asks to be told which tokens that meet `key` appear and vanish, those that are there first.
    ///
    /// # Errors
    /// As [`Session::declare_key`].
    pub fn declare_liveliness_subscriber(
        &mut self,
        key: &str,
    ) -> Result<LivelinessId, DeclareError> {
        self.declare(Kind::Liveliness, key).map(LivelinessId)
    }

    /// Takes a declaration back.
    ///
    /// # Errors
    /// [`UndeclareError`]; it stays declared then. The same holds for all `undeclare_…`.
    pub fn undeclare_key(&mut self, id: KeyId) -> Result<(), UndeclareError> {
        self.undeclare(Kind::Key, id.0)
    }

    /// Takes a declaration back; no message comes for it any more.
    ///
    /// # Errors
    /// As [`Session::undeclare_key`].
    pub fn undeclare_subscriber(&mut self, id: SubscriberId) -> Result<(), UndeclareError> {
        self.undeclare(Kind::Subscriber, id.0)
    }

    /// Takes a declaration back. Queries that came for it are still to be answered.
    ///
    /// # Errors
    /// As [`Session::undeclare_key`].
    pub fn undeclare_queryable(&mut self, id: QueryableId) -> Result<(), UndeclareError> {
        self.undeclare(Kind::Queryable { complete: false }, id.0)
    }

    /// Takes a declaration back; what was put through it is still sent.
    ///
    /// # Errors
    /// As [`Session::undeclare_key`].
    pub fn undeclare_publisher(&mut self, id: PublisherId) -> Result<(), UndeclareError> {
        self.undeclare(
            Kind::Publisher {
                answered: false,
                wanted: false,
            },
            id.0,
        )
    }

    /// Takes a sign of life down.
    ///
    /// # Errors
    /// As [`Session::undeclare_key`].
    pub fn undeclare_token(&mut self, id: TokenId) -> Result<(), UndeclareError> {
        self.undeclare(Kind::Token, id.0)
    }

    /// Takes a declaration back; nothing is told for it any more.
    ///
    /// # Errors
    /// As [`Session::undeclare_key`].
    pub fn undeclare_liveliness_subscriber(
        &mut self,
        id: LivelinessId,
    ) -> Result<(), UndeclareError> {
        self.undeclare(Kind::Liveliness, id.0)?;
        self.peer.forget_told(id.0);
        Ok(())
    }

    /// Whether anybody wants what a publisher sends, as far as is known: true while the router
    /// has not answered yet, false while the session is not open. Publishing is possible anyway.
    pub fn is_wanted(&self, publisher: PublisherId) -> bool {
        self.is_open()
            && self.declarations.entities().any(|entity| {
                entity.id == publisher.0
                    && matches!(
                        entity.kind,
                        Kind::Publisher {
                            answered: false,
                            ..
                        } | Kind::Publisher { wanted: true, .. }
                    )
            })
    }

    /// Publishes a value.
    ///
    /// # Errors
    /// [`PutError`]; nothing is queued then. [`PutError::Full`] is back-pressure: the value may
    /// be put again after transmission.
    pub fn put<'a>(
        &mut self,
        key: impl Into<KeyRef<'a>>,
        payload: &[u8],
        options: &PutOptions,
    ) -> Result<(), PutError> {
        self.push(key.into(), SampleKind::Put, payload, options)
    }

    /// Publishes that a key has no value any more. The encoding of the options has no meaning.
    ///
    /// # Errors
    /// As [`Session::put`].
    pub fn delete<'a>(
        &mut self,
        key: impl Into<KeyRef<'a>>,
        options: &PutOptions,
    ) -> Result<(), PutError> {
        self.push(key.into(), SampleKind::Delete, &[], options)
    }

    /// Asks a question. Any number of replies follow and exactly one final, which comes by
    /// itself after the timeout.
    ///
    /// # Errors
    /// [`GetError`]; nothing is queued then.
    pub fn get(
        &mut self,
        key: &str,
        parameters: &str,
        payload: Option<&[u8]>,
        options: &GetOptions,
        now_us: u64,
    ) -> Result<QueryId, GetError> {
        self.tick(now_us);
        let Link::Open {
            request_id_mask,
            closing_at_us: None,
            ..
        } = self.link
        else {
            return Err(GetError::Closed);
        };
        check_key(key).ok_or(GetError::Key)?;
        if self.queries.outbound.len() >= limits::QUERIES_OUT_MAX {
            return Err(GetError::TooMany);
        }
        let id = self.queries.free_id(request_id_mask);
        let wire_key = WireKey::Full(key);
        let bytes_hint = network::bytes_hint(
            wire_key,
            payload.unwrap_or_default(),
            options.attachment.as_ref(),
        ) + parameters.len();
        self.transmit
            .push(lane(options.priority), options.express, bytes_hint, |out| {
                network::write_query(out, id, wire_key, parameters, payload, options)
            })?;
        let deadline_us = self.now_us.saturating_add(options.timeout_us);
        let query = QueryOut::new(id, deadline_us, options.consolidation, parameters);
        self.queries.outbound.push(query);
        Ok(QueryId(id))
    }

    /// Answers a query with a value. It travels with the priority of the question, so that the
    /// final cannot overtake it; priority, congestion and express of the options have no meaning.
    ///
    /// # Errors
    /// [`ReplyError`]; nothing is queued then, and the query still waits for its final.
    pub fn reply(
        &mut self,
        query: &InboundQuery,
        key: &str,
        payload: &[u8],
        options: &PutOptions,
    ) -> Result<(), ReplyError> {
        self.push_reply(query, key, SampleKind::Put, payload, options)
    }

    /// Answers a query with the news that a key has no value.
    ///
    /// # Errors
    /// As [`Session::reply`].
    pub fn reply_delete(
        &mut self,
        query: &InboundQuery,
        key: &str,
        options: &PutOptions,
    ) -> Result<(), ReplyError> {
        self.push_reply(query, key, SampleKind::Delete, &[], options)
    }

    /// Answers a query with an error.
    ///
    /// # Errors
    /// As [`Session::reply`].
    pub fn reply_error(
        &mut self,
        query: &InboundQuery,
        payload: &[u8],
        encoding: &Encoding,
    ) -> Result<(), ReplyError> {
        self.demand_open_for_reply()?;
        let entry = self
            .queries
            .inbound(query.serial)
            .ok_or(ReplyError::Unknown)?;
        if !entry.waiting.contains(&query.queryable) {
            return Err(ReplyError::Unknown);
        }
        let bytes_hint = entry.key.len() + payload.len();
        self.transmit
            .push(lane(entry.priority), entry.express, bytes_hint, |out| {
                network::write_reply_error(
                    out,
                    entry.id,
                    WireKey::Full(&entry.key),
                    payload,
                    encoding,
                )
            })?;
        Ok(())
    }

    /// Says that no further answers come from this queryable.
    ///
    /// # Errors
    /// [`ReplyError`]; on [`ReplyError::Full`] it is to be said again.
    pub fn reply_final(&mut self, query: &InboundQuery) -> Result<(), ReplyError> {
        self.demand_open_for_reply()?;
        let inbound = &mut self.queries.inbound;
        let index = inbound.iter().position(|q| q.serial == query.serial);
        let index = index.ok_or(ReplyError::Unknown)?;
        let entry = &mut inbound[index];
        let waiting = entry.waiting.iter().position(|q| *q == query.queryable);
        let waiting = waiting.ok_or(ReplyError::Unknown)?;
        if entry.waiting.len() == 1 {
            self.transmit
                .push(lane(entry.priority), entry.express, 0, |out| {
                    network::write_reply_final(out, entry.id)
                })?;
            inbound.remove(index);
        } else {
            entry.waiting.remove(waiting);
        }
        Ok(())
    }

    fn declare(&mut self, kind: Kind, key: &str) -> Result<u32, DeclareError> {
        let id = self.declarations.declare(kind, key)?;
        self.tell();
        Ok(id)
    }

    fn undeclare(&mut self, kind: Kind, id: u32) -> Result<(), UndeclareError> {
        self.declarations.undeclare(kind, id)?;
        self.tell();
        Ok(())
    }

    fn tell(&mut self) {
        if self.is_open() {
            // What finds no room now is told at the next transmission.
            let _ = self.declarations.tell(&mut self.transmit);
        }
    }

    fn push(
        &mut self,
        key: KeyRef<'_>,
        kind: SampleKind,
        payload: &[u8],
        options: &PutOptions,
    ) -> Result<(), PutError> {
        if !self.is_open() {
            return Err(PutError::Closed);
        }
        let publisher = Kind::Publisher {
            answered: false,
            wanted: false,
        };
        let key = match key {
            KeyRef::Publisher(id) => self
                .declarations
                .wire_key(publisher, id.0)
                .ok_or(PutError::Unknown)?,
            KeyRef::Declared(id) => self
                .declarations
                .wire_key(Kind::Key, id.0)
                .ok_or(PutError::Unknown)?,
            KeyRef::Key(key) => {
                check_key(key).ok_or(PutError::Key)?;
                WireKey::Full(key)
            }
        };
        let bytes_hint = network::bytes_hint(key, payload, options.attachment.as_ref());
        self.transmit
            .push(lane(options.priority), options.express, bytes_hint, |out| {
                network::write_push(out, key, kind, payload, options)
            })?;
        Ok(())
    }

    fn demand_open_for_reply(&self) -> Result<(), ReplyError> {
        if self.is_open() {
            Ok(())
        } else {
            Err(ReplyError::Closed)
        }
    }

    fn push_reply(
        &mut self,
        query: &InboundQuery,
        key: &str,
        kind: SampleKind,
        payload: &[u8],
        options: &PutOptions,
    ) -> Result<(), ReplyError> {
        self.demand_open_for_reply()?;
        check_key(key).ok_or(ReplyError::Key)?;
        let entry = self
            .queries
            .inbound(query.serial)
            .ok_or(ReplyError::Unknown)?;
        if !entry.waiting.contains(&query.queryable) {
            return Err(ReplyError::Unknown);
        }
        let key = WireKey::Full(key);
        let bytes_hint = network::bytes_hint(key, payload, options.attachment.as_ref());
        let options = PutOptions {
            priority: entry.priority,
            congestion: entry.congestion,
            express: entry.express,
            ..options.clone()
        };
        self.transmit
            .push(lane(entry.priority), entry.express, bytes_hint, |out| {
                network::write_reply(out, entry.id, key, kind, payload, &options)
            })?;
        Ok(())
    }
}
