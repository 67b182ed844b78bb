//! Path parameters and headers as described in the API; the handlers read them themselves.

use utoipa::IntoParams;

/// A name in a path.
#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
#[allow(dead_code)] // described, never made: the handlers read it from the path
pub struct NameParam {
    /// Name of the model, source or session.
    #[param(pattern = "^[a-z0-9][a-z0-9-]{0,63}$")]
    name: String,
}

/// A camera in a path.
#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
#[allow(dead_code)] // as above
pub struct DeviceParam {
    /// Path of the device, percent-encoded, or identity of the camera.
    device: String,
}

/// A finished recording in a path.
#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
#[allow(dead_code)] // as above
pub struct FileParam {
    /// File name, as `GET /v1/recordings` lists it.
    #[param(pattern = "^[a-z0-9][a-z0-9-]{0,119}\\.(mcap|csv)$")]
    file: String,
}

/// Preconditions of a request.
#[derive(IntoParams)]
#[into_params(parameter_in = Header)]
#[allow(dead_code)] // as above
pub struct MatchHeaders {
    /// ETags, or `*`; 412 if none of them is current.
    #[param(rename = "If-Match")]
    if_match: Option<String>,
    /// ETags, or `*`. If one of them is current, changes return 412, and reads of models, scenes and files 304.
    #[param(rename = "If-None-Match")]
    if_none_match: Option<String>,
}

/// Headers of a request for a part of a file.
#[derive(IntoParams)]
#[into_params(parameter_in = Header)]
#[allow(dead_code)] // as above
pub struct RangeHeaders {
    /// Byte range: `bytes=0-99`, `bytes=100-` or `bytes=-100`.
    #[param(rename = "Range")]
    range: Option<String>,
    /// ETag of the file; if it is not current, the whole file is returned.
    #[param(rename = "If-Range")]
    if_range: Option<String>,
}
