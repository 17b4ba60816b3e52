//! Matrices that RTAB-Map compresses: a stream of zlib, then rows, columns and type of element as 32-bit integers.

use std::io::Read;

use flate2::read::ZlibDecoder;

/// The longest matrix that is read: poses of more than a million nodes.
const MOST_BYTES: usize = 64 << 20;

/// OpenCV's numbers of types, with one channel.
const INT_32: i32 = 4;
const FLOAT_32: i32 = 5;

const TAIL_BYTES: usize = 12;

/// The numbers of a matrix of 32-bit integers.
///
/// # Errors
/// What is wrong with it.
pub(super) fn integers(bytes: &[u8]) -> Result<Vec<i32>, String> {
    Ok(elements(bytes, INT_32)?.into_iter().map(i32::from_le_bytes).collect())
}

/// The numbers of a matrix of 32-bit floats.
///
/// # Errors
/// What is wrong with it.
pub(super) fn floats(bytes: &[u8]) -> Result<Vec<f32>, String> {
    Ok(elements(bytes, FLOAT_32)?.into_iter().map(f32::from_le_bytes).collect())
}

fn elements(bytes: &[u8], wanted: i32) -> Result<Vec<[u8; 4]>, String> {
    let Some((stream, tail)) = bytes.split_last_chunk::<TAIL_BYTES>() else {
        return Err(format!("a matrix has {} bytes", bytes.len()));
    };
    let word = |index: usize| i32::from_le_bytes(std::array::from_fn(|byte| tail[index * 4 + byte]));
    let (rows, columns, kind) = (word(0), word(1), word(2));
    if kind != wanted {
        return Err(format!("a matrix has elements of type {kind} in place of {wanted}"));
    }
    let size = usize::try_from(rows).ok().zip(usize::try_from(columns).ok());
    let size = size.and_then(|(rows, columns)| rows.checked_mul(columns)?.checked_mul(4));
    let size = size.filter(|size| *size <= MOST_BYTES);
    let size = size.ok_or_else(|| format!("a matrix says that it has {rows} x {columns} elements"))?;
    let mut data = Vec::new();
    // One byte more shows a stream that is longer than it should be.
    let read = ZlibDecoder::new(stream).take(size as u64 + 1).read_to_end(&mut data);
    read.map_err(|error| format!("a matrix cannot be decompressed: {error}"))?;
    if data.len() != size {
        return Err(format!("a matrix of {rows} x {columns} elements is not as long as it says"));
    }
    Ok(data.chunks_exact(4).map(|part| std::array::from_fn(|byte| part[byte])).collect())
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    fn packed(data: &[u8], rows: i32, columns: i32, kind: i32) -> Vec<u8> {
        let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::default());
        encoder.write_all(data).unwrap();
        let tail = [rows, columns, kind].map(i32::to_le_bytes).concat();
        [encoder.finish().unwrap(), tail].concat()
    }

    #[test]
    fn matrices_are_read() {
        let data: Vec<u8> = [7_i32, -2, 9].iter().flat_map(|value| value.to_le_bytes()).collect();
        assert_eq!(integers(&packed(&data, 1, 3, INT_32)), Ok(vec![7, -2, 9]));
        let data: Vec<u8> = [0.5_f32, -1.5].iter().flat_map(|value| value.to_le_bytes()).collect();
        assert_eq!(floats(&packed(&data, 2, 1, FLOAT_32)), Ok(vec![0.5, -1.5]));
        // As RTAB-Map 0.17 wrote the id of its one node.
        let taken =
            [0x78, 0x9c, 0x63, 0x64, 0x60, 0x60, 0, 0, 0, 8, 0, 2, 1, 0, 0, 0, 1, 0, 0, 0, 4, 0, 0, 0];
        assert_eq!(integers(&taken), Ok(vec![1]));
    }

    #[test]
    fn what_lies_about_its_size_is_refused() {
        let data = [0; 12];
        for (rows, columns, kind) in
            [(1, 2, INT_32), (1, 4, INT_32), (-1, -3, INT_32), (i32::MAX, i32::MAX, INT_32), (1, 3, FLOAT_32)]
        {
            assert!(integers(&packed(&data, rows, columns, kind)).is_err(), "{rows} {columns} {kind}");
        }
        assert!(integers(&[]).is_err());
        assert!(integers(&[&[1, 2, 3][..], &[1, 0, 0, 0, 1, 0, 0, 0, 4, 0, 0, 0]].concat()).is_err());
    }
}
