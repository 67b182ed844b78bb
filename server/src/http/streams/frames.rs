//! Pushed frames over a WebSocket, `isophote.v1`: each binary message is a frame, answered in order by a JSON text message, its
//! estimate or a problem. A text message, `{"time_s": 1.25}`, is the time of the next frame. While a frame is fitted the next
//! ones are decoded; further ones wait in the client's socket.

use std::collections::VecDeque;
use std::pin::Pin;
use std::sync::Arc;

use axum::extract::ws::{Message, WebSocket};
use isophote_wire::{EstimateView, FrameTime};
use serde::Deserialize;
use utoipa::ToSchema;

use super::pushed::{DecodedFrame, Pushed, WaitingFrame};
use super::websocket::{LifeSigns, close, refuse, send};
use crate::http::documents::parse;
use crate::hub::{End, Next, Subscription};
use crate::limits::LIMITS;
use crate::net::gate::MessageGate;
use crate::problem::Problem;

/// Text message before a frame. Unknown keys are ignored, since clients may be newer.
#[derive(Deserialize, ToSchema)]
struct FrameNote {
    #[serde(default)]
    time_s: Option<f64>,
}

type Decoding = Pin<Box<dyn Future<Output = Result<DecodedFrame, Problem>> + Send>>;

/// An event of the stream.
enum Turn {
    Ended(Next),
    Answered(Result<Arc<EstimateView>, Problem>),
    Decoded(Result<DecodedFrame, Problem>),
    Received(Option<Result<Message, axum::Error>>),
    Ping,
}

/// Serves until one side ends it. `subscription` reports the end of the session.
pub async fn serve(mut socket: WebSocket, pushed: Pushed, mut subscription: Subscription, gate: &MessageGate) {
    let pushed = Arc::new(pushed);
    let mut signs = LifeSigns::begin();
    // Frames are decoded one at a time, to keep their order; then they wait for their fits.
    let mut decoding: Option<Decoding> = None;
    let mut waiting: VecDeque<Result<WaitingFrame, Problem>> = VecDeque::new();
    let mut next = FrameTime::default();
    loop {
        let has_room = decoding.is_none() && waiting.len() < LIMITS.pushed_window;
        let turn = tokio::select! {
            end = subscription.end() => Turn::Ended(end),
            answer = first(&mut waiting) => Turn::Answered(answer),
            frame = decoded(&mut decoding) => Turn::Decoded(frame),
            received = socket.recv(), if has_room => Turn::Received(received),
            () = signs.due() => Turn::Ping,
        };
        match turn {
            Turn::Answered(answer) => {
                waiting.pop_front();
                if !tell(&mut socket, answer).await {
                    return;
                }
            }
            Turn::Decoded(frame) => {
                decoding = None;
                waiting.push_back(frame.and_then(|frame| pushed.push(frame)));
            }
            Turn::Ended(Next::End(end)) => {
                let unfinished = decoding.is_some().then(|| Err(Problem::session_ended()));
                let answers = waiting.into_iter().map(|one| one.and_then(WaitingFrame::last)).chain(unfinished);
                return leave(&mut socket, answers.collect(), &end).await;
            }
            Turn::Ended(Next::Estimate(_)) => {}
            Turn::Ping => {
                if !signs.ask(&mut socket).await {
                    return;
                }
            }
            Turn::Received(received) => {
                let Some(message) = signs.heard(&mut socket, received).await else { return };
                gate.message_over();
                match message {
                    Message::Binary(bytes) => {
                        let (pushed, FrameTime { time_s }) = (pushed.clone(), std::mem::take(&mut next));
                        decoding = Some(Box::pin(async move {
                            let media = pushed.media(&bytes);
                            let room = pushed.room_for(media).await;
                            pushed.decode(media, bytes.into(), time_s, room).await
                        }));
                    }
                    Message::Text(text) => match parse(&text) {
                        Ok(FrameNote { time_s }) => next = FrameTime { time_s },
                        Err(problem) => {
                            let why = problem.detail;
                            let reason = format!("frames are binary; text says when the next was taken: {why}");
                            return refuse(&mut socket, &reason).await;
                        }
                    },
                    Message::Close(_) | Message::Ping(_) | Message::Pong(_) => {}
                }
            }
        }
    }
}

/// The answer to the frame that has waited longest; pending if none waits.
async fn first(waiting: &mut VecDeque<Result<WaitingFrame, Problem>>) -> Result<Arc<EstimateView>, Problem> {
    match waiting.front_mut() {
        None => std::future::pending().await,
        Some(Ok(frame)) => frame.estimate().await,
        Some(Err(problem)) => Err(problem.clone()),
    }
}

/// The frame that is being decoded; pending if there is none.
async fn decoded(decoding: &mut Option<Decoding>) -> Result<DecodedFrame, Problem> {
    match decoding {
        None => std::future::pending().await,
        Some(decoding) => decoding.await,
    }
}

/// Answers every accepted frame, unless the service stops or the token was revoked.
async fn leave(socket: &mut WebSocket, answers: Vec<Result<Arc<EstimateView>, Problem>>, end: &End) {
    if !matches!(end, End::ServiceStops | End::Revoked) {
        for answer in answers {
            if !tell(socket, answer).await {
                return;
            }
        }
    }
    close(socket, end).await;
}

/// False if the answer was not sent.
async fn tell(socket: &mut WebSocket, answer: Result<Arc<EstimateView>, Problem>) -> bool {
    let json = match answer {
        Ok(estimate) => serde_json::to_string(&*estimate),
        Err(problem) => serde_json::to_string(&problem.document()),
    };
    match json {
        Ok(json) => send(socket, Message::Text(json.into()), LIMITS.send_time).await,
        Err(_) => false,
    }
}
