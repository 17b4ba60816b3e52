//! Chunks of records, compressed or not, read as they come: no chunk is ever whole in memory.

use std::io::{self, BufReader, Read};
use std::ops::ControlFlow;

use crate::input::{Fault, zstd_decoder};

/// The longest chunk that is read, once it is decompressed.
const MOST_CHUNK_BYTES: u64 = 1 << 30;

const BUFFER_BYTES: usize = 256 << 10;

/// What a chunk says of itself.
pub(super) struct ChunkSizes {
    /// In the file.
    pub(super) stored_bytes: u64,
    /// Decompressed.
    pub(super) plain_bytes: u64,
    /// CRC-32 of the decompressed bytes, if it has one.
    pub(super) crc: Option<u32>,
}

/// Reads one record and tells whether more are wanted; `None` where the records end.
type ReadRecord<'a> = dyn FnMut(&mut dyn Read) -> Result<Option<ControlFlow<()>>, Fault> + 'a;

/// Reads the decompressed records of a chunk, one at each call of `record`, until that finds no more, and holds them
/// against what the chunk says. A reader that stops in the middle of a chunk wants no more of it.
pub(super) fn read_chunk(
    file: &mut dyn Read,
    compression: &str,
    sizes: &ChunkSizes,
    record: &mut ReadRecord<'_>,
) -> Result<ControlFlow<()>, Fault> {
    let &ChunkSizes { stored_bytes, plain_bytes, crc } = sizes;
    if plain_bytes > MOST_CHUNK_BYTES {
        return Err(Fault::Wrong(format!(
            "a chunk says it has {plain_bytes} bytes; chunks of up to {MOST_CHUNK_BYTES} are read"
        )));
    }
    let mut stored = file.take(stored_bytes);
    {
        let decoder: Box<dyn Read + '_> = match compression {
            "" | "none" => Box::new(&mut stored),
            "zstd" => Box::new(zstd_decoder(&mut stored)?),
            "lz4" => Box::new(lz4_flex::frame::FrameDecoder::new(&mut stored)),
            "bz2" => Box::new(bzip2::read::MultiBzDecoder::new(&mut stored)),
            other => {
                return Err(Fault::Wrong(format!(
                    "a chunk's compression is `{other}`; none, zstd, lz4 and bz2 are read"
                )));
            }
        };
        let mut plain = Checked { inner: decoder, left: plain_bytes, hash: crc32fast::Hasher::new() };
        let mut records = BufReader::with_capacity(BUFFER_BYTES, &mut plain);
        while let Some(flow) = record(&mut records)? {
            if flow.is_break() {
                return Ok(flow);
            }
        }
        plain.finish(plain_bytes, crc)?;
    }
    // What a compressor put behind its last frame.
    io::copy(&mut stored, &mut io::sink())?;
    if stored.limit() > 0 { Err(Fault::Ended) } else { Ok(ControlFlow::Continue(())) }
}

/// Counts and hashes what is read, and reads no more than there should be.
struct Checked<R> {
    inner: R,
    left: u64,
    hash: crc32fast::Hasher,
}

impl<R: Read> Read for Checked<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let most = usize::try_from(self.left).map_or(buffer.len(), |left| left.min(buffer.len()));
        let read = self.inner.read(&mut buffer[..most])?;
        self.hash.update(&buffer[..read]);
        self.left -= read as u64;
        Ok(read)
    }
}

impl<R: Read> Checked<R> {
    fn finish(mut self, plain_bytes: u64, crc: Option<u32>) -> Result<(), Fault> {
        if self.left > 0 {
            return Err(Fault::Wrong(format!(
                "a chunk says it has {plain_bytes} bytes and has {}",
                plain_bytes - self.left
            )));
        }
        if self.inner.read(&mut [0])? > 0 {
            return Err(Fault::Wrong(format!("a chunk says it has {plain_bytes} bytes and has more")));
        }
        let computed = self.hash.finalize();
        match crc {
            Some(crc) if crc != computed => Err(Fault::Wrong(format!(
                "the CRC of a chunk is {crc:08x}, and that of its bytes {computed:08x}"
            ))),
            Some(_) | None => Ok(()),
        }
    }
}
