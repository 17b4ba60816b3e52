//! What may be sent as an image, what may not, and what the sender is told.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod scenes;

use std::io::Cursor;

use image::{DynamicImage, ImageBuffer, ImageFormat, Luma, LumaA, Rgb, Rgba};
use proptest::prelude::*;
use waypost_vision::image::{
    GreyImage, ImageError, MAX_ENCODED_BYTES, MAX_PIXELS, MAX_SIDE_PX, MIN_SIDE_PX, decode,
};

#[test]
fn png_keeps_grey_levels_exactly() {
    let scene = scenes::textured(80, 60, 1);
    let grey = ImageBuffer::<Luma<u8>, _>::from_raw(80, 60, scene.pixels().to_vec()).unwrap();
    assert_eq!(decode(&encoded(&grey.into(), ImageFormat::Png)), Ok(scene));
}

#[test]
fn jpeg_keeps_grey_levels_nearly() {
    let scene = scenes::textured(80, 60, 2);
    let decoded = decode(&scene.encode_jpeg(95).unwrap()).unwrap();
    assert_eq!((decoded.width(), decoded.height()), (80, 60));
    assert!(mean_difference(&decoded, &scene) < 2.0);
}

#[test]
fn colour_becomes_rec_601_luma_whatever_the_depth_and_alpha() {
    let colour = |x: u32, y: u32| [(x * 4) as u8, (y * 5) as u8, ((x + y) * 2) as u8];
    let wide = |byte: u8| u16::from(byte) * 257;
    let rgb8 = ImageBuffer::from_fn(64, 48, |x, y| Rgb(colour(x, y)));
    let rgba8 = ImageBuffer::from_fn(64, 48, |x, y| {
        let [r, g, b] = colour(x, y);
        Rgba([r, g, b, (x + y) as u8])
    });
    let rgb16 = ImageBuffer::from_fn(64, 48, |x, y| Rgb(colour(x, y).map(wide)));
    let rgba16 = ImageBuffer::from_fn(64, 48, |x, y| {
        let [r, g, b] = colour(x, y).map(wide);
        Rgba([r, g, b, (x * 900) as u16])
    });
    let images: [DynamicImage; 4] = [rgb8.into(), rgba8.into(), rgb16.into(), rgba16.into()];
    for image in images {
        let decoded = decode(&encoded(&image, ImageFormat::Png)).unwrap();
        let found = decoded.pixels().iter().zip((0..48).flat_map(|y| (0..64).map(move |x| (x, y))));
        for (&grey, (x, y)) in found {
            let [r, g, b] = colour(x, y).map(f64::from);
            let error = f64::from(grey) - (0.299 * r + 0.587 * g + 0.114 * b);
            assert!(error.abs() < 0.5 + 1e-9, "{:?}: off by {error} at ({x}, {y})", image.color());
        }
    }
}

#[test]
fn sixteen_bit_grey_is_rounded_and_grey_alpha_ignored() {
    let deep = ImageBuffer::from_fn(64, 48, |x, y| Luma([(x * 1000 + y * 50) as u16]));
    let rounded = ramp(|x, y| (f64::from(x * 1000 + y * 50) / 257.0).round() as u8);
    assert_eq!(decode(&encoded(&deep.into(), ImageFormat::Png)), Ok(rounded));

    let see_through = ImageBuffer::from_fn(64, 48, |x, y| LumaA([(x + y) as u8, 0u8]));
    assert_eq!(decode(&encoded(&see_through.into(), ImageFormat::Png)), Ok(ramp(|x, y| (x + y) as u8)));
}

#[test]
fn rarer_kinds_of_file_decode_too() {
    let shown = ramp(|x, y| {
        let (red, green) = (f64::from(x) * 255.0 / 63.0, f64::from(y) * 255.0 / 47.0);
        let blue = f64::from(x + y) * 255.0 / 110.0;
        (0.299 * red.round() + 0.587 * green.round() + 0.114 * blue.round()).round() as u8
    });
    let kinds: [(&str, &[u8], f64); 4] = [
        ("interlaced PNG", include_bytes!("fixtures/interlaced.png"), 0.01),
        ("palette PNG", include_bytes!("fixtures/palette.png"), 8.0),
        ("progressive JPEG", include_bytes!("fixtures/progressive.jpg"), 2.0),
        ("CMYK JPEG", include_bytes!("fixtures/cmyk.jpg"), 4.0),
    ];
    for (kind, bytes, tolerance) in kinds {
        let decoded = decode(bytes).unwrap();
        let difference = mean_difference(&decoded, &shown);
        assert!(difference < tolerance, "{kind}: differs by {difference} grey levels");
    }
}

#[test]
fn nothing_and_too_much_are_refused() {
    assert_eq!(decode(&[]), Err(ImageError::Empty));
    let mut huge = scenes::textured(64, 64, 3).encode_jpeg(90).unwrap();
    huge.resize(MAX_ENCODED_BYTES + 1, 0);
    assert_eq!(decode(&huge), Err(ImageError::TooManyBytes { bytes: MAX_ENCODED_BYTES + 1 }));
    huge.pop();
    assert!(decode(&huge).is_ok(), "padding behind the end marker does no harm");
}

#[test]
fn other_formats_are_called_by_their_name() {
    let others: [(&[u8], &str); 10] = [
        (b"GIF89a\x01\0\x01\0", "GIF"),
        (b"BM\x36\0\0\0", "BMP"),
        (b"RIFF\x24\0\0\0WEBPVP8 ", "WebP"),
        (b"II*\0\x08\0\0\0", "TIFF"),
        (b"P6\n2 2\n255\n", "PPM"),
        (b"P5\n2 2\n255\n", "PGM"),
        (b"\0\0\0\x18ftypheic", "HEIF"),
        (b"/9j/4AAQSkZJRg==", "base64"),
        (b"timestamp,x,y\r\n1,0,0\n", "but a text file"),
        (b"\x01\x02\x03", "01 02 03"),
    ];
    for (bytes, name) in others {
        let error = decode(bytes).unwrap_err();
        assert!(matches!(error, ImageError::UnknownFormat { .. }), "{error:?}");
        let message = error.to_string();
        assert!(message.contains(name) && message.contains("convert it to JPEG or PNG"), "{message}");
    }
}

#[test]
fn a_file_is_what_its_magic_bytes_say() {
    let mut png = encoded(&DynamicImage::new_luma8(64, 64), ImageFormat::Png);
    png[..3].copy_from_slice(b"\xff\xd8\xff");
    assert!(matches!(decode(&png), Err(ImageError::Damaged { .. } | ImageError::Truncated)));
}

#[test]
fn headers_beyond_the_limits_are_refused_by_name() {
    assert_eq!(
        decode(&scenes::png_claiming(30_000, 30_000)),
        Err(ImageError::TooLarge { width: 30_000, height: 30_000 })
    );
    assert_eq!(
        decode(&scenes::jpeg_claiming(65_535, 65_535)),
        Err(ImageError::TooLarge { width: 65_535, height: 65_535 })
    );
    assert!(decode(&scenes::png_claiming(i32::MAX as u32, i32::MAX as u32)).is_err());
    let message = ImageError::TooLarge { width: 30_000, height: 30_000 }.to_string();
    assert!(message.contains("900.0 megapixels") && message.contains("16 megapixels allowed"), "{message}");

    let thin = encoded(&DynamicImage::new_luma8(200, MIN_SIDE_PX - 1), ImageFormat::Png);
    assert_eq!(decode(&thin), Err(ImageError::TooSmall { width: 200, height: MIN_SIDE_PX - 1 }));
    let smallest = encoded(&DynamicImage::new_luma8(MIN_SIDE_PX, MIN_SIDE_PX), ImageFormat::Png);
    assert!(decode(&smallest).is_ok());
    let ribbon = encoded(&DynamicImage::new_luma8(MIN_SIDE_PX, MAX_SIDE_PX + 1), ImageFormat::Png);
    assert_eq!(decode(&ribbon), Err(ImageError::TooLong { width: MIN_SIDE_PX, height: MAX_SIDE_PX + 1 }));
}

#[test]
fn the_largest_image_decodes() {
    let largest = encoded(&DynamicImage::new_luma8(4000, (MAX_PIXELS / 4000) as u32), ImageFormat::Png);
    assert_eq!(decode(&largest).map(|image| image.width()), Ok(4000));
    let one_row_more =
        encoded(&DynamicImage::new_luma8(4000, (MAX_PIXELS / 4000) as u32 + 1), ImageFormat::Png);
    assert!(matches!(decode(&one_row_more), Err(ImageError::TooLarge { .. })));
}

#[test]
fn a_jpeg_cut_anywhere_is_refused() {
    let progressive = include_bytes!("fixtures/progressive.jpg").to_vec();
    for jpeg in [scenes::textured(96, 64, 4).encode_jpeg(80).unwrap(), progressive] {
        assert!(decode(&jpeg).is_ok());
        for kept in 1..jpeg.len() {
            assert!(decode(&jpeg[..kept]).is_err(), "decoded from {kept} of {} bytes", jpeg.len());
        }
        assert_eq!(decode(&jpeg[..jpeg.len() - 1]), Err(ImageError::Truncated));
        assert_eq!(decode(&jpeg[..jpeg.len() / 2]), Err(ImageError::Truncated));
    }
}

#[test]
fn a_png_cut_within_its_pixels_is_refused() {
    let scene = scenes::textured(96, 64, 5);
    let grey = ImageBuffer::<Luma<u8>, _>::from_raw(96, 64, scene.pixels().to_vec()).unwrap();
    let png = encoded(&grey.into(), ImageFormat::Png);
    let end_chunk_bytes = 12;
    let checksum_bytes = 4;
    for kept in 1..png.len() - end_chunk_bytes - checksum_bytes {
        assert!(decode(&png[..kept]).is_err(), "decoded from {kept} of {} bytes", png.len());
    }
    assert_eq!(decode(&png[..png.len() / 2]), Err(ImageError::Truncated));
}

#[test]
fn a_damaged_file_is_refused_with_the_reason() {
    let mut png = encoded(&DynamicImage::new_rgb8(64, 64), ImageFormat::Png);
    let middle = png.len() / 2;
    png[middle] ^= 0xff;
    let Err(ImageError::Damaged { reason }) = decode(&png) else { panic!("decoded a damaged PNG") };
    assert!(!reason.is_empty());

    let mut jpeg = scenes::textured(64, 64, 6).encode_jpeg(80).unwrap();
    let huffman_table = jpeg.windows(2).position(|marker| marker == b"\xff\xc4").unwrap();
    jpeg[huffman_table + 5..huffman_table + 21].fill(0xff);
    assert!(matches!(decode(&jpeg), Err(ImageError::Damaged { .. })), "{:?}", decode(&jpeg));
}

#[test]
fn jpeg_codings_that_are_not_decoded_are_unsupported_not_damaged() {
    let jpeg = scenes::textured(64, 64, 7).encode_jpeg(80).unwrap();
    let frame_header = jpeg.windows(2).position(|marker| marker == b"\xff\xc0").unwrap();
    for (offset, byte, named) in [(1, 0xc9, "arithmetic"), (1, 0xc3, "lossless"), (4, 12, "12 bits")] {
        let mut changed = jpeg.clone();
        changed[frame_header + offset] = byte;
        let error = decode(&changed).unwrap_err();
        assert!(matches!(error, ImageError::Unsupported { format: "JPEG", .. }), "{error:?}");
        let message = error.to_string();
        assert!(message.contains(named) && message.contains("baseline or progressive JPEG"), "{message}");
    }
}

#[test]
fn the_end_of_an_embedded_thumbnail_is_not_the_end_of_the_picture() {
    let jpeg = scenes::textured(64, 64, 12).encode_jpeg(80).unwrap();
    let thumbnail = scenes::textured(32, 32, 13).encode_jpeg(50).unwrap();
    let mut segment = vec![0xff, 0xe1];
    segment.extend(u16::try_from(thumbnail.len() + 2).unwrap().to_be_bytes());
    segment.extend(&thumbnail);
    let with_thumbnail = [&jpeg[..2], &segment, &jpeg[2..]].concat();
    assert_eq!(decode(&with_thumbnail), decode(&jpeg));
    let cut = &with_thumbnail[..with_thumbnail.len() - 20];
    assert_eq!(decode(cut), Err(ImageError::Truncated));
}

#[test]
fn an_image_is_validated_when_made() {
    assert_eq!(GreyImage::new(0, 3, vec![]), Err(ImageError::NoPixels { width: 0, height: 3 }));
    assert_eq!(
        GreyImage::new(2, 3, vec![0; 5]),
        Err(ImageError::PixelCount { width: 2, height: 3, pixels: 5 })
    );
    assert_eq!(
        GreyImage::new(u32::MAX, u32::MAX, vec![]),
        Err(ImageError::TooLarge { width: u32::MAX, height: u32::MAX })
    );
}

#[test]
fn shrinking_averages_areas_and_keeps_proportions() {
    let stripes =
        GreyImage::new(64, 30, (0..64 * 30).map(|i| if i % 2 == 0 { 50 } else { 150 }).collect()).unwrap();
    let half = stripes.resize_to_width(32).unwrap();
    assert_eq!((half.width(), half.height()), (32, 15));
    assert!(half.pixels().iter().all(|&grey| grey == 100));

    let panorama = scenes::textured(1000, 51, 8);
    let shrunk = panorama.resize_to_width(640).unwrap();
    assert_eq!((shrunk.width(), shrunk.height()), (640, 33));
    assert_eq!(*panorama.resize_to_width(2000).unwrap(), panorama);
    assert_eq!(panorama.resize_to_width(1).unwrap().height(), 1);
    assert!(matches!(panorama.resize_to_width(0), Err(ImageError::NoPixels { width: 0, .. })));
}

#[test]
fn a_thumbnail_needs_a_quality_and_a_side_that_jpeg_has() {
    let scene = scenes::textured(64, 64, 9);
    assert_eq!(scene.encode_jpeg(0), Err(ImageError::Quality { quality: 0 }));
    assert_eq!(scene.encode_jpeg(101), Err(ImageError::Quality { quality: 101 }));
    assert!(scene.encode_jpeg(20).unwrap().len() < scene.encode_jpeg(95).unwrap().len());
    let ribbon = GreyImage::new(70_000, 16, vec![0; 70_000 * 16]).unwrap();
    assert!(matches!(ribbon.encode_jpeg(50), Err(ImageError::Encode { .. })));
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn arbitrary_bytes_never_panic(
        magic in prop::sample::select(vec![&b""[..], b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n"]),
        rest in prop::collection::vec(any::<u8>(), 0..400),
    ) {
        prop_assert!(decode(&[magic, &rest].concat()).is_err());
    }

    #[test]
    fn damaged_files_never_panic(
        as_png in any::<bool>(),
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
    ) {
        let scene = scenes::textured(64, 40, 10);
        let grey = ImageBuffer::<Luma<u8>, _>::from_raw(64, 40, scene.pixels().to_vec()).unwrap();
        let format = if as_png { ImageFormat::Png } else { ImageFormat::Jpeg };
        let mut bytes = encoded(&grey.into(), format);
        for (at, byte) in damage {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        if let Ok(image) = decode(&bytes) {
            prop_assert_eq!(image.pixels().len() as u64, u64::from(image.width()) * u64::from(image.height()));
        }
    }
}

fn encoded(image: &DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

fn ramp(grey: impl Fn(u32, u32) -> u8) -> GreyImage {
    let pixels = (0..48).flat_map(|y| (0..64).map(move |x| (x, y))).map(|(x, y)| grey(x, y)).collect();
    GreyImage::new(64, 48, pixels).unwrap()
}

fn mean_difference(a: &GreyImage, b: &GreyImage) -> f64 {
    assert_eq!((a.width(), a.height()), (b.width(), b.height()));
    let total: u64 = a.pixels().iter().zip(b.pixels()).map(|(&x, &y)| u64::from(x.abs_diff(y))).sum();
    total as f64 / a.pixels().len() as f64
}

/// What a phone writes: the rows as the sensor has them, and how to turn them.
fn with_orientation(jpeg: &[u8], orientation: u8) -> Vec<u8> {
    let tiff = [
        b"II*\0\x08\0\0\0\x01\0".as_slice(),
        // Tag 0x0112, one short.
        &[0x12, 0x01, 3, 0, 1, 0, 0, 0, orientation, 0, 0, 0],
        &[0; 4],
    ]
    .concat();
    let length = u16::try_from(tiff.len() + 8).unwrap().to_be_bytes();
    [&jpeg[..2], b"\xff\xe1", &length, b"Exif\0\0", &tiff, &jpeg[2..]].concat()
}

#[test]
fn an_upright_photo_that_lies_on_its_side_in_the_file_is_turned() {
    let bright_above = ramp(|_, y| if y < 24 { 200 } else { 20 });
    let jpeg = bright_above.encode_jpeg(90).unwrap();
    let upright = decode(&jpeg).unwrap();
    assert_eq!((upright.width(), upright.height()), (64, 48));
    assert_eq!(decode(&with_orientation(&jpeg, 1)).unwrap(), upright);
    // 6: to be turned clockwise, so what was above is on the right.
    let turned = decode(&with_orientation(&jpeg, 6)).unwrap();
    assert_eq!((turned.width(), turned.height()), (48, 64));
    let at = |x: u32, y: u32| turned.pixels()[(y * 48 + x) as usize];
    assert!(at(40, 5) > 150 && at(40, 60) > 150 && at(5, 5) < 60 && at(5, 60) < 60);
}
