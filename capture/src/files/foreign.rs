//! Remedies for file formats that are not supported, by extension.

use std::path::Path;

/// Extensions and their remedies.
const OTHERS: [(&[&str], &str); 10] = [
    (&["gz", "z"], "it is packed, so unpack it first: gunzip FILE (only FITS files are read as .fits.gz)"),
    (&["bz2"], "it is packed, so unpack it first: bunzip2 FILE"),
    (&["xz"], "it is packed, so unpack it first: unxz FILE"),
    (&["zst", "lz4"], "it is packed, so unpack it first: unzstd FILE, or unlz4 FILE"),
    (&["zip", "tar", "tgz", "7z", "rar"], "it is an archive: unpack it, and name the folder"),
    (&["bag", "db3"], "convert it to MCAP, which keeps topics and times: mcap convert FILE OUT.mcap"),
    (
        &[
            "mp4", "m4v", "mov", "avi", "mkv", "webm", "mpg", "mpeg", "wmv", "mts", "h264", "h265", "mjpg", "mjpeg",
            "gif", "webp",
        ],
        "convert it to Y4M (ffmpeg -i FILE OUT.y4m), or its frames to PNG (ffmpeg -i FILE %06d.png)",
    ),
    (&["heic", "heif", "avif", "jxl", "jp2"], "convert it to JPEG or PNG"),
    (
        &["dng", "cr2", "cr3", "nef", "arw", "raf", "orf", "rw2"],
        "convert it to a TIFF of 16 bits without a tone curve: dcraw -4 -T FILE",
    ),
    (
        &[
            "npy", "npz", "mat", "h5", "hdf5", "exr", "pfm", "dcm", "nd2", "czi", "lif", "lsm", "stk", "xisf", "ser",
            "asdf",
        ],
        "save its pictures as TIFF (16 bit, or 32-bit float) or FITS, which keep its values",
    ),
];

/// The remedy for a file in an unsupported format.
pub(crate) fn remedy(path: &Path) -> &'static str {
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_ascii_lowercase());
    let named =
        |(names, _): &&(&[&str], &str)| extension.as_deref().is_some_and(|extension| names.contains(&extension));
    OTHERS
        .iter()
        .find(named)
        .map_or("convert it to PNG (8 or 16 bit), or to TIFF where it has fractions", |(_, what)| what)
}
