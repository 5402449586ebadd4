//! `/metrics`: one text for all scrapes that run at the same time.
//!
//! A large table makes tens of megabytes. So the text is made once for all scrapes that run together, and
//! kept compressed, which takes a thirtieth. A client without gzip gets it unpacked piece by piece. A
//! scrape that begins after a text is complete gets a new one.

use std::collections::VecDeque;
use std::io::{self, Write};
use std::sync::{Arc, Mutex, PoisonError, Weak};

use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::HeaderMap;
use axum::http::header::{ACCEPT_ENCODING, CONTENT_ENCODING, CONTENT_TYPE, VARY};
use axum::response::{IntoResponse, Response};
use flate2::Compression;
use flate2::write::{GzDecoder, GzEncoder};
use futures_util::stream;
use tokio::sync::watch;
use tokio::task::yield_now;

use super::Shared;
use super::turn::Turn;
use crate::observe::metrics::{self, Metrics};

/// About how many octets of text are compressed or unpacked in one turn.
const PIECE: usize = 32 * 1024;
/// How many texts are kept for slow clients. When another one is made, clients of the oldest are cut.
pub(super) const MOST_TEXTS: usize = 8;

/// `GET /metrics`
pub(super) async fn scrape(State(shared): State<Shared>, headers: HeaderMap) -> Response {
    let reader = shared.scrapes.read(&shared.metrics, &shared.turn);
    let headers_of_all = [(CONTENT_TYPE, metrics::CONTENT_TYPE), (VARY, ACCEPT_ENCODING.as_str())];
    if takes_gzip(&headers) {
        let encoding = [(CONTENT_ENCODING, "gzip")];
        return (headers_of_all, encoding, reader.compressed()).into_response();
    }
    (headers_of_all, reader.unpacked(shared.turn)).into_response()
}

/// The texts that are being read, oldest first.
#[derive(Clone, Debug, Default)]
pub(super) struct Scrapes(Arc<Mutex<VecDeque<Weak<watch::Sender<Text>>>>>);

/// A text, complete or still growing.
#[derive(Debug, Default)]
struct Text {
    /// Parts of one gzip stream. Each can be unpacked after those before it.
    pieces: Vec<Bytes>,
    state: Progress,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Progress {
    #[default]
    Growing,
    Whole,
    /// It was dropped in favour of later ones.
    Cut,
}

impl Scrapes {
    #[cfg(test)]
    pub(super) fn body_of(&self, metrics: &Metrics, turn: &Turn) -> Body {
        self.read(metrics, turn).compressed()
    }

    /// A reader of the text that is being made, or of a new one.
    fn read(&self, metrics: &Metrics, turn: &Turn) -> Reader {
        let mut texts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        texts.retain(|text| text.strong_count() > 0);
        let newest = texts.back().and_then(Weak::upgrade);
        if let Some(text) = newest.filter(|text| text.borrow().state == Progress::Growing) {
            return Reader::of(text);
        }
        if texts.len() >= MOST_TEXTS
            && let Some(oldest) = texts.pop_front().and_then(|text| text.upgrade())
        {
            oldest.send_replace(Text { pieces: Vec::new(), state: Progress::Cut });
        }
        let text = Arc::new(watch::Sender::new(Text::default()));
        texts.push_back(Arc::downgrade(&text));
        tokio::spawn(make(metrics.clone(), turn.clone(), Arc::downgrade(&text)));
        Reader::of(text)
    }
}

/// Makes a text; stops when nobody reads it any more.
async fn make(metrics: Metrics, turn: Turn, text: Weak<watch::Sender<Text>>) {
    let mut chunks = turn.take(|| metrics.chunks()).await;
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    while let Some(chunk) = turn.take(|| chunks.next()).await {
        for piece in chunk.as_bytes().chunks(PIECE) {
            let compressed = turn.take(|| {
                // Writing to memory does not fail.
                encoder.write_all(piece).and_then(|()| encoder.flush()).unwrap_or_default();
                std::mem::take(encoder.get_mut())
            });
            let compressed = compressed.await;
            let Some(text) = text.upgrade() else { return };
            text.send_modify(|text| text.grow(compressed));
        }
    }
    let Some(text) = text.upgrade() else { return };
    let end = encoder.finish().unwrap_or_default();
    text.send_modify(|text| {
        text.grow(end);
        if text.state == Progress::Growing {
            text.state = Progress::Whole;
        }
    });
}

impl Text {
    fn grow(&mut self, piece: Vec<u8>) {
        if self.state == Progress::Growing {
            self.pieces.push(piece.into());
        }
    }
}

/// One scrape of a text.
#[derive(Debug)]
struct Reader {
    text: watch::Receiver<Text>,
    next: usize,
    /// Keeps the text alive.
    _text: Arc<watch::Sender<Text>>,
}

impl Reader {
    fn of(text: Arc<watch::Sender<Text>>) -> Self {
        Self { text: text.subscribe(), next: 0, _text: text }
    }

    /// Waits for the next piece; none at the end. Fails when the text was dropped.
    async fn next(&mut self) -> io::Result<Option<Bytes>> {
        let next = self.next;
        let ready = |text: &Text| text.pieces.len() > next || text.state != Progress::Growing;
        let text = self.text.wait_for(ready).await.map_err(io::Error::other)?;
        if text.state == Progress::Cut {
            return Err(io::Error::other("too many later scrapes"));
        }
        self.next += 1;
        Ok(text.pieces.get(next).cloned())
    }

    fn compressed(self) -> Body {
        Body::from_stream(stream::unfold(self, async |mut reader| {
            let piece = reader.next().await.transpose()?;
            yield_now().await;
            Some((piece, reader))
        }))
    }

    fn unpacked(self, turn: Turn) -> Body {
        let decoder = GzDecoder::new(Vec::new());
        Body::from_stream(stream::unfold((self, decoder), move |(mut reader, mut decoder)| {
            let turn = turn.clone();
            async move {
                let piece = match reader.next().await.transpose()? {
                    Ok(piece) => turn.take(|| unpack(&mut decoder, &piece)).await,
                    Err(error) => Err(error),
                };
                Some((piece, (reader, decoder)))
            }
        }))
    }
}

fn unpack(decoder: &mut GzDecoder<Vec<u8>>, piece: &[u8]) -> io::Result<Vec<u8>> {
    decoder.write_all(piece)?;
    decoder.flush()?;
    Ok(std::mem::take(decoder.get_mut()))
}

/// Whether the client accepts gzip, and prefers it to plain text (RFC 9110, 12.5.3).
pub(super) fn takes_gzip(headers: &HeaderMap) -> bool {
    let fields = headers.get_all(ACCEPT_ENCODING).iter().filter_map(|value| value.to_str().ok());
    let codings: Vec<_> = fields.flat_map(|field| field.split(',')).map(coding).collect();
    let weight = |names: &[&str]| {
        let named = |(name, _): &&(&str, f32)| names.iter().any(|n| name.eq_ignore_ascii_case(n));
        codings.iter().find(named).map(|(_, weight)| *weight)
    };
    let gzip = weight(&["gzip", "x-gzip"]).or(weight(&["*"])).unwrap_or(0.0);
    gzip > 0.0 && gzip >= weight(&["identity"]).unwrap_or(0.0)
}

/// The name and weight of an element of `Accept-Encoding`; an invalid weight is 0.
fn coding(element: &str) -> (&str, f32) {
    let (name, parameters) = element.split_once(';').unwrap_or((element, ""));
    let weight = match parameters.trim().split_once('=') {
        None => 1.0,
        Some((_, weight)) => {
            weight.trim().parse().ok().filter(|q| (0.0..=1.0).contains(q)).unwrap_or(0.0)
        }
    };
    (name.trim(), weight)
}

#[cfg(test)]
mod tests {
    use axum::http::HeaderValue;

    use super::*;

    #[test]
    fn gzip_is_for_those_who_ask_for_it() {
        for (fields, expected) in [
            (&[][..], false),
            (&[""], false),
            (&["gzip"], true),
            (&["GZip"], true),
            (&["x-gzip"], true),
            (&["deflate, br"], false),
            (&["br;q=1.0, gzip;q=0.8, *;q=0.1"], true),
            (&["deflate", "gzip"], true),
            (&["gzip;q=0"], false),
            (&["gzip; q=0.000, *"], false),
            (&["gzip ; q = 0.001"], true),
            (&["*"], true),
            (&["*;q=0"], false),
            (&["identity"], false),
            (&["identity;q=0.5, gzip;q=0.4"], false),
            (&["identity;q=0.5, gzip;q=0.5"], true),
            (&["identity;q=0, gzip"], true),
            (&["gzip;q=2"], false),
            (&["gzip;q=NaN"], false),
            (&["gzip;q=-1"], false),
            (&["gzipped"], false),
        ] {
            let mut headers = HeaderMap::new();
            for field in fields {
                headers.append(ACCEPT_ENCODING, HeaderValue::from_str(field).unwrap());
            }
            assert_eq!(takes_gzip(&headers), expected, "{fields:?}");
        }
    }
}
