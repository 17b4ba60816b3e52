//! A file as a stream that knows where it is and whether it ended too early.

use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::{Path, PathBuf};

use crate::error::BagError;

/// The longest message that is read: an image of 16 megapixels in colour.
pub const MOST_MESSAGE_BYTES: u64 = 64 << 20;

/// Sizes of windows of zstd that are accepted, as a power of two: 64 MiB.
pub(crate) const MOST_WINDOW_LOG: u32 = 26;

const BUFFER_BYTES: usize = 1 << 20;

/// How far a file is read, as read and all bytes.
pub type Progress<'a> = dyn FnMut(u64, u64) + 'a;

/// A file that is read from its start to its end.
pub(crate) struct Input<'p, 'q> {
    path: PathBuf,
    inner: Box<dyn Read>,
    position: u64,
    size: u64,
    told: u64,
    /// Whether reading met the end of the file.
    ended: bool,
    hash: crc32fast::Hasher,
    progress: &'p mut Progress<'q>,
}

impl<'p, 'q> Input<'p, 'q> {
    /// Opens a file; one that ends in `.zstd` or `.zst` is decompressed on the way.
    pub(crate) fn open(path: &Path, progress: &'p mut Progress<'q>) -> Result<Self, BagError> {
        let failed = |source| BagError::File { path: path.to_owned(), source };
        let file = File::open(path).map_err(failed)?;
        let size = file.metadata().map_err(failed)?.len();
        let inner: Box<dyn Read> = if is_compressed(path) {
            Box::new(BufReader::with_capacity(BUFFER_BYTES, zstd_decoder(file).map_err(failed)?))
        } else {
            Box::new(BufReader::with_capacity(BUFFER_BYTES, file))
        };
        let hash = crc32fast::Hasher::new();
        Ok(Self { path: path.to_owned(), inner, position: 0, size, told: 0, ended: false, hash, progress })
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    pub(crate) fn position(&self) -> u64 {
        self.position
    }

    pub(crate) fn size(&self) -> u64 {
        self.size
    }

    /// Whether reading met the end of the file.
    pub(crate) fn has_ended(&self) -> bool {
        self.ended
    }

    /// CRC-32 of all that was read so far.
    pub(crate) fn crc(&self) -> u32 {
        self.hash.clone().finalize()
    }
}

impl Read for Input<'_, '_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.inner.read(buffer)?;
        self.hash.update(&buffer[..read]);
        self.ended |= read == 0 && !buffer.is_empty();
        self.position += read as u64;
        if self.position - self.told >= BUFFER_BYTES as u64 {
            self.told = self.position;
            (self.progress)(self.position.min(self.size), self.size);
        }
        Ok(read)
    }
}

/// By the end of its name.
pub(crate) fn is_compressed(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending == "zstd" || ending == "zst")
}

/// Decompresses zstd, with a bound on the memory that it may ask for.
pub(crate) fn zstd_decoder<'a, R: Read + 'a>(
    reader: R,
) -> io::Result<zstd::stream::read::Decoder<'a, BufReader<R>>> {
    let mut decoder = zstd::stream::read::Decoder::new(reader)?;
    decoder.window_log_max(MOST_WINDOW_LOG)?;
    Ok(decoder)
}

/// Why a record could not be read.
#[derive(Debug)]
pub(crate) enum Fault {
    /// The stream ended in the middle of it.
    Ended,
    /// The stream could not be read, or not decompressed.
    Unreadable(io::Error),
    /// It contradicts the format.
    Wrong(String),
    /// What was done with it failed.
    Bag(BagError),
}

impl From<io::Error> for Fault {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::UnexpectedEof => Fault::Ended,
            _ => Fault::Unreadable(error),
        }
    }
}

impl From<BagError> for Fault {
    fn from(error: BagError) -> Self {
        Fault::Bag(error)
    }
}

impl From<crate::bytes::Malformed> for Fault {
    fn from(malformed: crate::bytes::Malformed) -> Self {
        Fault::Wrong(format!("a record is malformed {malformed}"))
    }
}

/// Reads exactly `size` bytes into `buffer`, which never grows to more than about twice of what is there.
pub(crate) fn read_bytes(reader: &mut dyn Read, size: u64, buffer: &mut Vec<u8>) -> Result<(), Fault> {
    buffer.clear();
    let read = reader.take(size).read_to_end(buffer)?;
    if (read as u64) < size { Err(Fault::Ended) } else { Ok(()) }
}

pub(crate) fn skip_bytes(reader: &mut dyn Read, size: u64) -> Result<(), Fault> {
    let skipped = io::copy(&mut reader.take(size), &mut io::sink())?;
    if skipped < size { Err(Fault::Ended) } else { Ok(()) }
}

/// Reads as many bytes as there are, up to the array's length.
pub(crate) fn read_some<const SIZE: usize>(reader: &mut dyn Read) -> Result<(usize, [u8; SIZE]), Fault> {
    let mut bytes = [0; SIZE];
    let mut filled = 0;
    while filled < SIZE {
        match reader.read(&mut bytes[filled..]) {
            Ok(0) => break,
            Ok(read) => filled += read,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error.into()),
        }
    }
    Ok((filled, bytes))
}
