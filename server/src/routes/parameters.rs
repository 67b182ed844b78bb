//! What the description of the API says of names and headers; the handlers read them by themselves.

use utoipa::IntoParams;

/// A name in a path.
#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
#[allow(dead_code)] // described, never made: the handlers read it from the path
pub struct NameParam {
    /// Of the model, source or session.
    #[param(pattern = "^[a-z0-9][a-z0-9-]{0,63}$")]
    name: String,
}

/// A camera in a path.
#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
#[allow(dead_code)] // as above
pub struct DeviceParam {
    /// A path, percent-encoded, or an identity.
    device: String,
}

/// A finished recording in a path.
#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
#[allow(dead_code)] // as above
pub struct FileParam {
    /// As recordings are listed.
    #[param(pattern = "^[a-z0-9][a-z0-9-]{0,119}\\.(mcap|csv)$")]
    file: String,
}

/// What a writer expects to be there.
#[derive(IntoParams)]
#[into_params(parameter_in = Header)]
#[allow(dead_code)] // as above
pub struct MatchHeaders {
    /// ETags, or `*`; 412 where something else is there.
    #[param(rename = "If-Match")]
    if_match: Option<String>,
    /// ETags, or `*`; where one of them is there, 304 of a read and 412 of a change.
    #[param(rename = "If-None-Match")]
    if_none_match: Option<String>,
}

/// A part of a file.
#[derive(IntoParams)]
#[into_params(parameter_in = Header)]
#[allow(dead_code)] // as above
pub struct RangeHeaders {
    /// `bytes=0-99`, `bytes=100-` or `bytes=-100`.
    #[param(rename = "Range")]
    range: Option<String>,
    /// An ETag: the whole file where it has another one.
    #[param(rename = "If-Range")]
    if_range: Option<String>,
}
