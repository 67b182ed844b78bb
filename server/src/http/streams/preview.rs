//! Previews over a WebSocket, `isophote.v1`: one binary message per frame. A ping follows each message; its pong shows that the
//! message was read, so little more than one message is in flight, whatever is buffered on the way.

use std::time::{Duration, Instant};

use axum::extract::ws::{Message, WebSocket, close_code};
use tokio::sync::oneshot;

use super::pace::PreviewPace;
use super::websocket::{Credit, LifeSigns, close, finish, renewed, send};
use crate::hub::{Next, Subscription};
use crate::limits::LIMITS;
use crate::preview::{PreviewForm, PreviewMessage, PreviewSeat, ShownFrame};

/// What a viewer asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PreviewWish {
    /// The form of the preview.
    pub form: PreviewForm,
    /// Largest rate of messages.
    pub rate_hz: f64,
    /// Messages before the viewer renews its credit; `None`: unlimited.
    pub credit: Option<u32>,
}

/// An event of the stream.
enum Turn {
    Ended(Next),
    Drawn(Result<ShownFrame, oneshot::error::RecvError>),
    Received(Option<Result<Message, axum::Error>>),
    Ping,
}

/// Serves until one side ends it. `subscription` reports the end of the session.
pub async fn serve(mut socket: WebSocket, seat: PreviewSeat, mut subscription: Subscription, wish: PreviewWish) {
    let mut credit = wish.credit.map_or(Credit::Open, Credit::Counted);
    let mut pace = PreviewPace::default();
    let way = pace.send(0, Instant::now());
    if !send(&mut socket, ping(way), LIMITS.send_time).await {
        return;
    }
    let period = Duration::from_secs_f64(1.0 / wish.rate_hz);
    let mut due = Instant::now();
    let mut asked: Option<oneshot::Receiver<ShownFrame>> = None;
    let mut after_seen = 0;
    let mut signs = LifeSigns::begin();
    loop {
        if asked.is_none() && credit.is_left() && pace.is_free(Instant::now()) {
            let (quality, step) = pace.level();
            let form = PreviewForm { quality, step: wish.form.step * step, ..wish.form };
            let form = if form.format == isophote_wire::PreviewFormat::Jpeg { form } else { wish.form };
            let from = due.checked_sub(period / 2).unwrap_or(due);
            asked = Some(seat.ask(form, from, due, after_seen));
        }
        let turn = tokio::select! {
            end = subscription.end() => Turn::Ended(end),
            drawn = drawn(&mut asked) => Turn::Drawn(drawn),
            received = socket.recv() => Turn::Received(received),
            () = signs.due() => Turn::Ping,
        };
        match turn {
            Turn::Ended(Next::End(end)) => return close(&mut socket, &end).await,
            Turn::Ended(Next::Estimate(_)) => {}
            Turn::Drawn(drawn) => {
                asked = None;
                let Ok(ShownFrame { number, message, quota }) = drawn else {
                    return finish(&mut socket, close_code::ERROR, "the preview cannot be drawn").await;
                };
                after_seen = number + 1;
                let now = Instant::now();
                // A late message does not hasten the next ones.
                due = (due + period).max(now.checked_sub(period).unwrap_or(now));
                let number = pace.send(message.len(), now);
                if !deliver(&mut socket, &mut subscription, message, number).await {
                    return;
                }
                drop(quota);
                credit.spend();
            }
            Turn::Ping => {
                if !signs.ask(&mut socket).await {
                    return;
                }
            }
            Turn::Received(received) => {
                let Some(message) = signs.heard(&mut socket, received).await else { return };
                if let Message::Pong(number) = &message
                    && let Ok(number) = <[u8; 8]>::try_from(&number[..])
                {
                    pace.read(u64::from_le_bytes(number), Instant::now());
                }
                if !renewed(&mut socket, &mut credit, &message).await {
                    return;
                }
            }
        }
    }
}

/// The requested message; pending if none is requested.
async fn drawn(asked: &mut Option<oneshot::Receiver<ShownFrame>>) -> Result<ShownFrame, oneshot::error::RecvError> {
    match asked {
        Some(asked) => asked.await,
        None => std::future::pending().await,
    }
}

/// Sends a message and a ping. The write may last while the client acknowledges bytes, which the socket checks; when the
/// session ends, only a moment. False if it was not sent.
async fn deliver(
    socket: &mut WebSocket,
    subscription: &mut Subscription,
    message: PreviewMessage,
    number: u64,
) -> bool {
    let ended = async {
        subscription.end().await;
        tokio::time::sleep(LIMITS.drain_time / 2).await;
    };
    let sent = tokio::select! {
        sent = socket.send(Message::Binary(message)) => sent.is_ok(),
        () = ended => false,
    };
    sent && send(socket, ping(number), LIMITS.send_time).await
}

/// Its pong shows that all messages before it were read.
fn ping(number: u64) -> Message {
    Message::Ping(number.to_le_bytes().to_vec().into())
}
