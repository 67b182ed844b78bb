//! Previews: messages, formats and parts; the frame shown; back-pressure; and no drawing without viewers.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use isophote_wire::{EstimateView, PreviewFormat, PreviewHeader, PreviewPart};
use serde_json::json;
use tungstenite::Message;

use crate::client::{Running, Socket, picture, session, synthetic};

/// Pushes frames, one after the other, until dropped.
struct Pushing {
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Drop for Pushing {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        let pushed = self.thread.take().map(JoinHandle::join);
        assert!(std::thread::panicking() || pushed.is_none_or(|pushed| pushed.is_ok()), "a frame was refused");
    }
}

impl Running {
    /// Pushes `frame` of 0, 1, 2 …
    fn pushing(&self, session: &str, frame: impl Fn(f64) -> Vec<u8> + Send + 'static) -> Pushing {
        let (service, path) = (Running::at(&self.address), format!("/v1/sessions/{session}/frames"));
        let ends = Arc::<AtomicBool>::default();
        let should_end = ends.clone();
        let push = move || {
            let mut turn = 0.0;
            while !should_end.load(Ordering::Relaxed) {
                let headers = [("content-type", "application/octet-stream")];
                service.request("POST", &path, &headers, &frame(turn)).expect(200);
                turn += 1.0;
            }
        };
        let thread = std::thread::Builder::new().name("push".into()).spawn(push).unwrap();
        Pushing { ends, thread: Some(thread) }
    }

    fn preview(&self, session: &str, query: &str) -> Socket {
        self.open(&format!("/v1/sessions/{session}/preview?{query}"), "isophote.v1").unwrap()
    }

    /// A value of the session in `/metrics`.
    fn counted(&self, name: &str, session: &str) -> f64 {
        let text = self.get("/metrics").text;
        let line = format!("{name}{{session=\"{session}\"}} ");
        let value = text.lines().find_map(|text| text.strip_prefix(line.as_str()));
        value.unwrap_or_else(|| panic!("no {line}in\n{text}")).parse().unwrap()
    }
}

/// The next message: header and pixels.
fn shown(socket: &mut Socket) -> (PreviewHeader, Vec<u8>) {
    let message = socket.next_bytes().unwrap();
    let (header, pixels) = PreviewHeader::read(&message).unwrap();
    (header, pixels.to_vec())
}

/// The first message with a tracked target.
fn tracked(socket: &mut Socket) -> (PreviewHeader, Vec<u8>, EstimateView) {
    for _ in 0..1000 {
        let (header, pixels) = shown(socket);
        let estimate = header.drawing.estimate.clone().filter(|estimate| estimate.covariance.is_some());
        if let Some(estimate) = estimate {
            return (header, pixels, estimate);
        }
    }
    panic!("never tracked");
}

#[test]
fn every_format_and_part() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("realtime", 200.0)).expect(201);
    for (part, format) in [
        ("frame", "raw8"),
        ("frame", "raw16"),
        ("frame", "jpeg"),
        ("window", "raw8"),
        ("residual", "raw8"),
        ("residual", "raw16"),
        ("residual", "jpeg"),
    ] {
        for scale in [1.0, 0.5] {
            let mut socket = service.preview("one", &format!("part={part}&format={format}&scale={scale}&rate=60"));
            assert_eq!(socket.protocol(), "isophote.v1");
            let (PreviewHeader { pixels, drawing }, bytes, _) = tracked(&mut socket);
            let to_json = |value| serde_json::to_value(value).unwrap();
            assert_eq!((to_json(json!(pixels.part)), to_json(json!(pixels.format))), (json!(part), json!(format)));
            assert_eq!((drawing.session.as_str(), drawing.frame_size), ("one", [64, 48]));
            let window = drawing.window.unwrap();
            let step = if scale < 1.0 { 2 } else { 1 };
            let (first, size) = match part {
                "frame" => ([0, 0], [64, 48]),
                _ => ([window.x, window.y], [window.width, window.height]),
            };
            assert_eq!((pixels.step, [pixels.width, pixels.height]), (step, size.map(|side| side / step)));
            assert_eq!(pixels.origin, first.map(|first| first as f64 + (step - 1) as f64 / 2.0), "{part} {format}");
            let count = pixels.width * pixels.height;
            match pixels.format {
                PreviewFormat::Raw8 => assert_eq!(bytes.len(), count),
                PreviewFormat::Raw16 => assert_eq!(bytes.len(), 2 * count),
                PreviewFormat::Jpeg => {
                    assert_eq!((&bytes[..2], &bytes[bytes.len() - 2..]), (&[0xff, 0xd8][..], &[0xff, 0xd9][..]))
                }
            }
            let levels = [pixels.levels.low, pixels.levels.high];
            let expected = if pixels.part == PreviewPart::Residual { [-5.0, 5.0] } else { [0.0, 255.0] };
            assert_eq!(levels, expected);
            assert!(!drawing.contour.is_empty() && drawing.section.is_some());
            // The document's domain extends beyond its outline.
            let width = |lines: &[Vec<[f64; 2]>]| {
                let xs = || lines[0].iter().map(|[x, _]| *x);
                xs().fold(f64::MIN, f64::max) - xs().fold(f64::MAX, f64::min)
            };
            let (outline, edge) = (width(&drawing.outline), width(&drawing.contour));
            assert!(outline > 1.0 && outline < edge, "{outline} {edge}");
        }
    }
}

#[test]
fn pictures_match_their_estimates() {
    let service = Running::start();
    let source = json!({"kind": "pushed", "width": 64, "height": 48, "format": "u8"});
    service.put("/v1/sessions/one", &json!({"source": source, "model": "spot"})).expect(201);
    let mut socket = service.preview("one", "rate=60");
    let spot = |turn: f64| {
        let centre = (30.0 + 6.0 * (0.3 * turn).sin(), 23.0 + 3.0 * (0.2 * turn).cos());
        (picture(64, 48, centre), centre)
    };
    let pushed = service.pushing("one", move |turn| spot(turn).0);
    for _ in 0..15 {
        let (header, pixels) = shown(&mut socket);
        let drawing = header.drawing;
        let own = drawing.estimate.unwrap();
        assert_eq!(own.frame, drawing.frame);
        let [x, y] = ["bx", "by"].map(|name| own.parameters.get(name).unwrap());
        // The source numbers the pushed frames.
        let (own_pixels, centre) = spot(drawing.frame as f64);
        assert_eq!(pixels, own_pixels, "the very pixels of frame {}", drawing.frame);
        assert!((x - centre.0).abs() < 0.1 && (y - centre.1).abs() < 0.1, "{x} {y} {centre:?}");
        let section = drawing.section.unwrap();
        assert_eq!(section.y, y.round() as usize);
        let of_row = section.x.iter().map(|x| Some(f32::from(pixels[section.y * 64 + x])));
        assert_eq!(section.observed, of_row.collect::<Vec<_>>());
        // The edge of the domain s ≤ 2.2.
        for [px, py] in drawing.contour.concat() {
            let [a1, a3] = ["a1", "a3"].map(|name| own.parameters.get(name).unwrap());
            let s = (px - x).powi(2) * a1 + (py - y).powi(2) * a3;
            assert!((s - 2.2).abs() < 0.06, "{px} {py}: {s}");
        }
    }
    drop(pushed);
}

#[test]
fn lost_targets_have_no_outline() {
    let service = Running::start();
    let mut source = synthetic("realtime", 100.0);
    source["set"]["v1"] = json!(0);
    service.put("/v1/sessions/one", &json!({"source": source, "model": "spot"})).expect(201);
    let (header, pixels) = shown(&mut service.preview("one", ""));
    assert_eq!(pixels.len(), 64 * 48);
    assert!(header.drawing.contour.is_empty() && header.drawing.section.is_none() && header.drawing.window.is_none());
    assert_eq!(json!(header.drawing.estimate.unwrap().state), "searching");
}

#[test]
fn overlays_use_the_model_of_the_fit() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("realtime", 100.0)).expect(201);
    let mut socket = service.preview("one", "rate=60&part=residual");
    tracked(&mut socket);
    service.put("/v1/sessions/one/model", &json!({"model": "gaussian"})).expect(200);
    let mut seen = Vec::new();
    while seen.len() < 2 || seen.last() == seen.first() {
        let (header, _, estimate) = tracked(&mut socket);
        let name = estimate.model.split('@').next().unwrap().to_string();
        let value = |name: &str| estimate.parameters.get(name).unwrap();
        // The contour is the edge of that model's own domain.
        let edge = if name == "spot" { 2.2 } else { 4.0 };
        for [x, y] in header.drawing.contour.concat() {
            let (dx, dy) = (x - value("bx"), y - value("by"));
            let s = value("a1") * dx * dx + 2.0 * value("a2") * dx * dy + value("a3") * dy * dy;
            assert!((s - edge).abs() < 0.08, "{name}: {s}");
        }
        seen.push(name);
    }
}

#[test]
fn nothing_is_drawn_without_viewers() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("realtime", 200.0)).expect(201);
    service.wait_for("one", |view| view["frames"].as_u64().unwrap() > 20);
    let counts = || {
        ["isophote_preview_viewers", "isophote_preview_frames_total", "isophote_preview_messages_total"]
            .map(|name| service.counted(name, "one"))
    };
    assert_eq!(counts(), [0.0; 3]);
    let mut several: Vec<Socket> = (0..4).map(|_| service.preview("one", "rate=20")).collect();
    for _ in 0..5 {
        several.iter_mut().for_each(|socket| _ = shown(socket));
    }
    let [viewers, _, messages] = counts();
    assert!(viewers == 4.0 && messages >= 5.0, "{viewers} {messages}");
    drop(several);
    while counts()[0] > 0.0 {}
    let after = counts();
    let frames = service.get("/v1/sessions/one").expect(200)["frames"].as_u64().unwrap();
    service.wait_for("one", |view| view["frames"].as_u64().unwrap() > frames + 20);
    assert_eq!(counts(), after);
}

#[test]
fn viewers_of_one_rate_share_drawings() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("realtime", 200.0)).expect(201);
    let mut several: Vec<Socket> = (0..5).map(|_| service.preview("one", "rate=25")).collect();
    let mut shown_frames: Vec<Vec<u64>> = vec![Vec::new(); several.len()];
    for _ in 0..20 {
        for (socket, frames) in several.iter_mut().zip(&mut shown_frames) {
            frames.push(shown(socket).0.drawing.frame);
        }
    }
    let drawn = service.counted("isophote_preview_messages_total", "one");
    assert!(drawn < 60.0, "{drawn} messages were made for 5 times 20: {shown_frames:?}");
    assert!(shown_frames.iter().all(|frames| frames.is_sorted()));
}

#[test]
fn stalled_viewers_hold_up_nobody() {
    let service = Running::start();
    let mut source = synthetic("realtime", 60.0);
    (source["width"], source["height"]) = (json!(640), json!(480));
    service.put("/v1/sessions/one", &json!({"source": source, "model": "spot"})).expect(201);
    let _silent: Vec<Socket> = (0..3).map(|_| service.preview("one", "rate=60")).collect();
    let mut reader = service.preview("one", "rate=60");
    let first = shown(&mut reader).0.drawing.frame;
    let mut last = first;
    for _ in 0..40 {
        let frame = shown(&mut reader).0.drawing.frame;
        assert!(frame > last);
        last = frame;
    }
    // Stalled viewers got a message or two each: the rest was drawn for the reader.
    let made = service.counted("isophote_preview_messages_total", "one");
    assert!(made <= 41.0 + 3.0 * 4.0, "{made}");
}

#[test]
fn viewers_get_no_more_than_their_credit() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("realtime", 100.0)).expect(201);
    let mut socket = service.preview("one", "rate=60&credit=2");
    let second = [shown(&mut socket), shown(&mut socket)][1].0.drawing.frame;
    service.wait_for("one", |view| view["last"]["frame"].as_u64().unwrap() > second + 30);
    socket.send("{\"credit\":1}");
    assert!(shown(&mut socket).0.drawing.frame > second + 30, "the newest, not one that waited");
    for text in ["credit", "{\"credit\":-1}"] {
        let mut socket = service.preview("one", "credit=0");
        socket.send(text);
        assert_eq!(socket.next_bytes(), Err(1008), "{text}");
    }
}

#[test]
fn wrong_preview_queries_are_refused() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("realtime", 100.0)).expect(201);
    for (query, names) in [
        ("format=png", "format"),
        ("part=all", "part"),
        ("rate=0", "rate"),
        ("rate=61", "rate"),
        ("rate=nan", "rate"),
        ("rate=fast", "rate"),
        ("scale=0", "scale"),
        ("scale=1.5", "scale"),
        ("scale=-1", "scale"),
        ("scale=inf", "scale"),
        ("credit=65537", "credit"),
        ("speed=1", "speed"),
        ("shadow=2", "shadow"),
    ] {
        let problem = service.get(&format!("/v1/sessions/one/preview?{query}")).expect(400);
        assert!(problem["detail"].as_str().unwrap().contains(names), "{query}: {problem}");
        let path = format!("/v1/sessions/one/preview?{query}");
        assert_eq!(service.open(&path, "isophote.v1").err(), Some(400), "{query}");
    }
    service.get("/v1/sessions/one/preview").expect(400);
    service.get("/v1/sessions/nobody/preview").expect(404);
    assert_eq!(service.open("/v1/sessions/nobody/preview", "isophote.v1").err(), Some(404));
    assert_eq!(service.open("/v1/sessions/one/preview", "chat").err(), Some(400));
}

#[test]
fn shadows_have_previews_of_the_same_frames() {
    let service = Running::start();
    service.put("/v1/sessions/one", &session("realtime", 100.0)).expect(201);
    assert_eq!(service.open("/v1/sessions/one/preview?shadow=1", "isophote.v1").err(), Some(404));
    service.put("/v1/sessions/one/shadow", &json!({"model": "gaussian"})).expect(201);
    let mut own = service.preview("one", "part=residual");
    let mut shadow = service.preview("one", "part=residual&shadow=1");
    let (_, _, fitted) = tracked(&mut own);
    let (head, pixels, beside) = tracked(&mut shadow);
    assert!(fitted.model.starts_with("spot@") && beside.model.starts_with("gaussian@"), "{}", beside.model);
    assert_eq!(pixels.len(), head.pixels.width * head.pixels.height);
    assert!(head.drawing.section.is_some() && head.drawing.frame == beside.frame);
    service.delete("/v1/sessions/one/shadow");
    while shadow.next_bytes().is_ok() {}
    shown(&mut own);
}

#[test]
fn stacks_show_the_slice_through_the_centre() {
    let service = Running::start();
    let source = json!({"kind": "synthetic", "model": "blob-3d", "width": 24, "height": 20, "depth": 12, "samples": 1,
                        "rate_hz": 50, "set": {"bx": 11, "by": 9.4, "bz": 6.3}});
    service.put("/v1/sessions/deep", &json!({"source": source, "model": "blob-3d"})).expect(201);
    let (PreviewHeader { pixels, drawing }, bytes, _) = tracked(&mut service.preview("deep", ""));
    assert_eq!((&drawing.slice[..], pixels.width * pixels.height), (&[6][..], bytes.len()));
    assert!(drawing.outline[0].len() > 20 && !drawing.contour.is_empty() && drawing.section.is_some());
}

#[test]
fn how_a_preview_ends() {
    let service = Running::start();
    let end = |socket: &mut Socket| loop {
        if let Err(code) = socket.next_bytes() {
            return code;
        }
    };
    service.put("/v1/sessions/one", &session("realtime", 100.0)).expect(201);
    let (mut open, mut waiting) = (service.preview("one", ""), service.preview("one", "credit=0"));
    shown(&mut open);
    service.delete("/v1/sessions/one");
    assert_eq!((end(&mut open), end(&mut waiting)), (1000, 1000), "stopped");

    service.put("/v1/sessions/one", &session("realtime", 100.0)).expect(201);
    let mut open = service.preview("one", "format=jpeg");
    shown(&mut open);
    let stopping = std::thread::Builder::new().name("stop".into()).spawn(move || service.stop()).unwrap();
    assert_eq!(end(&mut open), 1001, "the service stops");
    stopping.join().unwrap();
}

#[test]
fn two_targets_and_a_wide_pixel() {
    let service = Running::start();
    let mut frame = vec![0u8; 2 * 96 * 64];
    let at = |x: f64, y: f64, centre: [f64; 2]| {
        let s = ((x - centre[0]).powi(2) + (y - centre[1]).powi(2)) / 64.0;
        if s <= 1.0 { 1.0 - 0.5 * s - 0.3 * s * s - 0.2 * s * s * s } else { 0.0 }
    };
    for (i, pixel) in frame.chunks_exact_mut(2).enumerate() {
        let (x, y) = ((i % 96) as f64, (i / 96) as f64);
        let value = 400.0 + 3000.0 * at(x, y, [25.0, 30.0]) + 2600.0 * at(x, y, [65.0, 34.0]);
        pixel.copy_from_slice(&((value as u16).min(3200)).to_le_bytes());
    }
    let source = json!({"kind": "pushed", "width": 96, "height": 64, "format": "u16le"});
    let session = json!({"source": source, "model": "spot", "camera": {"saturation": 3200}, "options": {"targets": 2}});
    service.put("/v1/sessions/two", &session).expect(201);
    let mut socket = service.preview("two", "format=raw16&rate=60");
    let mut narrow = service.preview("two", "format=raw8&rate=60");
    let own = frame.clone();
    let pushed = service.pushing("two", move |_| own.clone());
    let mut both = shown(&mut socket);
    while both.0.drawing.contour.len() < 2 {
        both = shown(&mut socket);
    }
    let (header, pixels) = both;
    assert_eq!((pixels, header.pixels.levels.high), (frame.clone(), 65535.0));
    assert_eq!((header.drawing.estimates.len(), header.drawing.contour.len()), (2, 2));
    let is_full =
        |x: usize, y: usize| u16::from_le_bytes([frame[2 * (y * 96 + x)], frame[2 * (y * 96 + x) + 1]]) >= 3200;
    let full: Vec<[usize; 2]> = (0..64 * 96).map(|i| [i % 96, i / 96]).filter(|[x, y]| is_full(*x, *y)).collect();
    let saturated: Vec<[usize; 2]> =
        header.drawing.saturated.iter().flat_map(|[y, first, last]| (*first..=*last).map(move |x| [x, *y])).collect();
    assert!(!full.is_empty());
    assert_eq!(saturated, full);
    assert_eq!(header.drawing.section.unwrap().saturation, Some(3200.0));
    let (header, pixels) = shown(&mut narrow);
    assert_eq!(header.pixels.levels.high, 3200.0);
    assert_eq!(pixels[0], (400.0f64 / 3200.0 * 255.0).round() as u8);
    drop(pushed);
}

impl Socket {
    /// The next binary message, or the code with which the service closed.
    fn next_bytes(&mut self) -> Result<Vec<u8>, u16> {
        loop {
            match self.read() {
                Message::Binary(bytes) => return Ok(bytes.to_vec()),
                Message::Close(frame) => return Err(frame.map_or(0, |frame| frame.code.into())),
                _ => {}
            }
        }
    }
}
