//! PNG files in memory, and as data URLs.

use schemas::Fault;

/// Meaning of the bytes of a pixel.
pub enum PixelFormat {
    /// Red, green, blue.
    Rgb,
    /// Red, green, blue, opacity.
    Rgba,
    /// Table of the colours and their opacities; a pixel is an index into it.
    Indexed(Vec<[u8; 4]>),
}

/// PNG of `size` (width, height) of the `pixels`, by rows from the top.
///
/// # Errors
/// Fails if the number of pixels does not match the size, or is zero.
pub fn encode(kind: &PixelFormat, size: (usize, usize), pixels: &[u8]) -> Result<Vec<u8>, Fault> {
    write(kind, size, pixels).map_err(|e| Fault::machine(format!("cannot draw the map: {e}")))
}

fn write(kind: &PixelFormat, size: (usize, usize), pixels: &[u8]) -> Result<Vec<u8>, Box<dyn std::error::Error>> {
    let mut out = vec![];
    let mut encoder = png::Encoder::new(&mut out, u32::try_from(size.0)?, u32::try_from(size.1)?);
    encoder.set_depth(png::BitDepth::Eight);
    // High compression makes the millions of pixels of a figure only a tenth smaller, but takes ten times as long.
    let indexed = matches!(kind, PixelFormat::Indexed(_));
    encoder.set_compression(if indexed { png::Compression::High } else { png::Compression::Balanced });
    match kind {
        PixelFormat::Rgb => encoder.set_color(png::ColorType::Rgb),
        PixelFormat::Rgba => encoder.set_color(png::ColorType::Rgba),
        PixelFormat::Indexed(colours) => {
            encoder.set_color(png::ColorType::Indexed);
            encoder.set_palette(colours.iter().flat_map(|[r, g, b, _]| [*r, *g, *b]).collect::<Vec<u8>>());
            encoder.set_trns(colours.iter().map(|c| c[3]).collect::<Vec<u8>>());
        }
    }
    let mut writer = encoder.write_header()?;
    writer.write_image_data(pixels)?;
    writer.finish()?;
    Ok(out)
}

/// PNG as a data URL.
pub fn data_url(png: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::from("data:image/png;base64,");
    for three in png.chunks(3) {
        let bits = three.iter().fold(0u32, |bits, b| bits << 8 | u32::from(*b)) << (8 * (3 - three.len()));
        for k in 0..4 {
            let letter = LETTERS[(bits >> (18 - 6 * k)) as usize & 63];
            out.push(if k <= three.len() { char::from(letter) } else { '=' });
        }
    }
    out
}

/// Size and stored pixels of a PNG.
#[cfg(test)]
pub fn decode(png: &[u8]) -> Option<((usize, usize), Vec<u8>)> {
    let mut reader = png::Decoder::new(std::io::Cursor::new(png)).read_info().ok()?;
    let mut pixels = vec![0; reader.output_buffer_size()?];
    let info = reader.next_frame(&mut pixels).ok()?;
    Some(((info.width as usize, info.height as usize), pixels))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ref_base64() {
        // RFC 4648, section 10.
        let cases = [
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foob", "Zm9vYg=="),
            ("fooba", "Zm9vYmE="),
            ("foobar", "Zm9vYmFy"),
        ];
        for (text, coded) in cases {
            assert_eq!(data_url(text.as_bytes()), format!("data:image/png;base64,{coded}"));
        }
    }

    #[test]
    fn unit_pixels_round_trip_and_a_wrong_count_is_rejected() {
        let pixels: Vec<u8> = (0..24).collect();
        let png = encode(&PixelFormat::Rgba, (3, 2), &pixels).unwrap();
        assert_eq!(decode(&png), Some(((3, 2), pixels.clone())));
        assert!(encode(&PixelFormat::Rgb, (3, 2), &pixels).is_err() && encode(&PixelFormat::Rgb, (0, 2), &[]).is_err());
    }
}
