//! Plots as files: the numbers as CSV, the picture as PNG.

use crate::{message::Moment, model::node::Node, panels::node::Page};
use egui::ColorImage;
use std::collections::BTreeMap;

/// Returns the numbers of a page's plots, a line a moment; `None` for a page without plots.
pub fn csv(node: &Node, page: Page) -> Option<String> {
    match page {
        Page::Motion | Page::Path => Some(motion_csv(node)),
        Page::Clock => Some(clock_csv(node)),
        Page::Overview | Page::Lines | Page::Setup => None,
    }
}

fn motion_csv(node: &Node) -> String {
    let samples = || node.samples().iter();
    let axis_count = samples().map(|sample| sample.axes.len()).max().unwrap_or(0);
    let mut text = String::from("heard_unix_us,node_us,queue_commands,laser_percent");
    for axis in 0..axis_count {
        text += &format!(",position{axis}_steps,speed{axis}_hz");
    }
    text.push('\n');
    for sample in samples() {
        let (at, node_at) = (sample.at.0, sample.node_at.0);
        text += &format!(
            "{at},{node_at},{},{}",
            sample.queue_depth, sample.laser_percent
        );
        for axis in 0..axis_count {
            match sample.axes.get(axis) {
                Some(axis) => {
                    let speed_hz = f64::from(axis.speed_mhz) / 1e3;
                    text += &format!(",{},{speed_hz}", axis.position_steps);
                }
                None => text += ",,",
            }
        }
        text.push('\n');
    }
    text
}

fn clock_csv(node: &Node) -> String {
    let mut rows: BTreeMap<Moment, [String; 2]> = BTreeMap::new();
    for known in node.clocks().iter() {
        let clock = known.clock;
        let (offset_us, error_us) = (clock.offset_us, clock.error_us);
        let row = rows.entry(known.at).or_default();
        row[0] = format!("{offset_us},{error_us},{}", clock.drift_ppm);
    }
    for known in node.travelled().iter() {
        let [shortest_us, longest_us] = known.rtt_us;
        rows.entry(known.at).or_default()[1] = format!("{shortest_us},{longest_us}");
    }
    let mut text =
        String::from("heard_unix_us,offset_us,error_us,drift_ppm,rtt_us_min,rtt_us_max\n");
    for (at, [clock, travel]) in rows {
        let clock = if clock.is_empty() { ",," } else { &clock };
        let travel = if travel.is_empty() { "," } else { &travel };
        text += &format!("{},{clock},{travel}\n", at.0);
    }
    text
}

/// Returns a picture as PNG.
///
/// # Errors
/// The picture is empty.
pub fn png(image: &ColorImage) -> Result<Vec<u8>, String> {
    let [width, height] = image.size;
    let side = |pixels: usize| u32::try_from(pixels).map_err(|_| "too large".to_owned());
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, side(width)?, side(height)?);
    encoder.set_color(png::ColorType::Rgba);
    encoder.set_depth(png::BitDepth::Eight);
    let pixels: Vec<u8> = image
        .pixels
        .iter()
        .flat_map(egui::Color32::to_srgba_unmultiplied)
        .collect();
    let mut writer = encoder.write_header().map_err(|error| error.to_string())?;
    let written = writer.write_image_data(&pixels);
    written.map_err(|error| error.to_string())?;
    drop(writer);
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_is_read_back_as_it_was() {
        let colors = [egui::Color32::RED, egui::Color32::BLUE];
        let image = ColorImage::new([2, 1], colors.to_vec());
        let bytes = png(&image).expect("a picture");
        let decoder = png::Decoder::new(std::io::Cursor::new(bytes));
        let mut reader = decoder.read_info().expect("a head");
        let mut pixels = [0; 8];
        let frame = reader.next_frame(&mut pixels).expect("pixels");
        assert_eq!((frame.width, frame.height), (2, 1));
        assert_eq!(pixels, [255, 0, 0, 255, 0, 0, 255, 255]);
        assert!(png(&ColorImage::default()).is_err());
    }
}
