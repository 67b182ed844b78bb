//! Estimates over a WebSocket, `isophote.v1`: one JSON text message an estimate, as long as the client has credit.

use std::time::{Duration, Instant};

use axum::extract::ws::{CloseFrame, Message, WebSocket, close_code};
use isophote_wire::CreditDocument;
use tokio::time::Interval;

use crate::http::documents::parse;
use crate::hub::{End, Next, Subscription};
use crate::limits::LIMITS;

/// Number of messages that the client still accepts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Credit {
    /// As many as the socket takes.
    Open,
    /// A counted credit.
    Counted(u32),
}

impl Credit {
    pub fn is_left(self) -> bool {
        self != Credit::Counted(0)
    }
    pub fn spend(&mut self) {
        if let Credit::Counted(n) = self {
            *n = n.saturating_sub(1);
        }
    }
    /// A client that never named a credit starts to count with its first renewal.
    pub fn renew(&mut self, more: u32) {
        let left = if let Credit::Counted(n) = *self { n } else { 0 };
        *self = Credit::Counted(left.saturating_add(more).min(LIMITS.credit));
    }
}

/// Keep-alive: pings, and the time of the client's last message.
pub struct LifeSigns {
    ping: Interval,
    heard: Instant,
}

impl LifeSigns {
    /// Begins with a new client.
    pub fn begin() -> LifeSigns {
        let mut ping = tokio::time::interval(LIMITS.ping_time);
        ping.reset();
        LifeSigns { ping, heard: Instant::now() }
    }
    /// Notes a received message and returns it; `None` ends the stream: the client is gone or violates the protocol.
    pub async fn heard(
        &mut self,
        socket: &mut WebSocket,
        received: Option<Result<Message, axum::Error>>,
    ) -> Option<Message> {
        match received? {
            Ok(message) => {
                self.heard = Instant::now();
                Some(message)
            }
            Err(error) => {
                break_off(socket, error).await;
                None
            }
        }
    }
    /// Waits until a ping is due.
    pub async fn due(&mut self) {
        self.ping.tick().await;
    }
    /// Sends a ping; false if the client has been silent for too long, or the write fails.
    pub async fn ask(&self, socket: &mut WebSocket) -> bool {
        !self.is_silent(Instant::now()) && send(socket, Message::Ping(Vec::new().into()), LIMITS.send_time).await
    }
    /// Whether the client has been silent for too long.
    fn is_silent(&self, now: Instant) -> bool {
        now.saturating_duration_since(self.heard) > LIMITS.silence_time
    }
}

/// Handles a subscriber's message, which may renew its credit; false if it is invalid and ends the stream.
pub(super) async fn renewed(socket: &mut WebSocket, credit: &mut Credit, message: &Message) -> bool {
    let fault = match message {
        Message::Text(text) => match parse::<CreditDocument>(text) {
            Ok(more) => {
                credit.renew(more.credit);
                return true;
            }
            Err(problem) => problem.detail,
        },
        Message::Binary(_) => "messages are JSON text".into(),
        Message::Close(_) | Message::Ping(_) | Message::Pong(_) => return true,
    };
    refuse(socket, &fault).await;
    false
}

/// An event of the stream.
enum Turn {
    Send(Next),
    Received(Option<Result<Message, axum::Error>>),
    Ping,
}

/// Serves a subscription until one side ends it.
pub async fn serve(mut socket: WebSocket, mut subscription: Subscription, credit: Option<u32>) {
    let mut credit = credit.map_or(Credit::Open, Credit::Counted);
    let mut signs = LifeSigns::begin();
    loop {
        let next = async { if credit.is_left() { subscription.next().await } else { subscription.end().await } };
        let turn = tokio::select! {
            received = socket.recv() => Turn::Received(received),
            () = signs.due() => Turn::Ping,
            next = next => Turn::Send(next),
        };
        match turn {
            Turn::Send(Next::Estimate(estimate)) => {
                credit.spend();
                let mut messages = vec![estimate.json()];
                while let Some(more) = if credit.is_left() { subscription.more() } else { None } {
                    credit.spend();
                    messages.push(more.json());
                }
                subscription.sent(messages.iter().map(String::len).sum());
                for json in messages {
                    if !send(&mut socket, Message::Text(json.into()), LIMITS.send_time).await {
                        return;
                    }
                }
            }
            Turn::Send(Next::End(end)) => return close(&mut socket, &end).await,
            Turn::Ping => {
                if !signs.ask(&mut socket).await {
                    return;
                }
            }
            Turn::Received(received) => {
                let Some(message) = signs.heard(&mut socket, received).await else { return };
                if !renewed(&mut socket, &mut credit, &message).await {
                    return;
                }
            }
        }
    }
}

/// False if the message was not sent.
pub(super) async fn send(socket: &mut WebSocket, message: Message, deadline: Duration) -> bool {
    matches!(tokio::time::timeout(deadline, socket.send(message)).await, Ok(Ok(())))
}

/// Closes the stream of a client that violates the subprotocol.
pub(super) async fn refuse(socket: &mut WebSocket, reason: &str) {
    finish(socket, close_code::POLICY, reason).await;
}

/// Closes the stream of a client with invalid WebSocket frames, with the code of RFC 6455.
async fn break_off(socket: &mut WebSocket, error: axum::Error) {
    let text = error.to_string();
    let code = match error.into_inner().downcast_ref::<tungstenite::Error>() {
        Some(tungstenite::Error::Protocol(_)) => close_code::PROTOCOL,
        Some(tungstenite::Error::Utf8(_)) => close_code::INVALID,
        Some(tungstenite::Error::Capacity(_)) => close_code::SIZE,
        _ => return, // the client is gone
    };
    finish(socket, code, &text).await;
}

/// Closes the stream with the reason of its end.
pub(super) async fn close(socket: &mut WebSocket, end: &End) {
    match end {
        End::ServiceStops => finish(socket, close_code::AWAY, "the service stops").await,
        End::SessionStopped => finish(socket, close_code::NORMAL, "the session was stopped").await,
        End::SourceEnded(reason) => finish(socket, close_code::NORMAL, reason).await,
        End::Unreachable => {}
        End::Revoked => finish(socket, close_code::POLICY, "the token was revoked").await,
        End::SessionFailed(reason) => finish(socket, close_code::ERROR, reason).await,
    }
}

/// Sends the close frame and waits a moment for the client's, so that earlier messages are not lost.
pub(super) async fn finish(socket: &mut WebSocket, code: u16, reason: &str) {
    let reason: String = reason
        .chars()
        .scan(0, |bytes, c| {
            *bytes += c.len_utf8();
            (*bytes <= 120).then_some(c)
        })
        .collect();
    if send(socket, Message::Close(Some(CloseFrame { code, reason: reason.into() })), LIMITS.drain_time).await {
        let answered = async { while let Some(Ok(_)) = socket.recv().await {} };
        drop(tokio::time::timeout(LIMITS.drain_time / 2, answered).await); // the socket is closed in any case
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A client that lost its network sends no close. The timeout spans several pings.
    #[tokio::test]
    async fn a_silent_client_times_out_after_several_pings() {
        let signs = LifeSigns::begin();
        let after = |time: Duration| signs.heard + time;
        assert!(!signs.is_silent(signs.heard) && !signs.is_silent(after(LIMITS.silence_time)));
        assert!(signs.is_silent(after(LIMITS.silence_time + Duration::from_millis(1))));
        assert!(LIMITS.silence_time >= 3 * LIMITS.ping_time);
    }

    #[test]
    fn credit_is_spent_and_renewed() {
        let mut credit = Credit::Counted(1);
        credit.spend();
        assert!(!credit.is_left());
        credit.renew(2);
        assert_eq!(credit, Credit::Counted(2));
        credit.renew(u32::MAX);
        assert_eq!(credit, Credit::Counted(LIMITS.credit));
        let mut open = Credit::Open;
        open.spend();
        assert_eq!(open, Credit::Open);
    }
}
