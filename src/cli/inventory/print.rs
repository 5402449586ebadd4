//! An inventory as a table for people, as CSV, or as one JSON object a line.

use std::io::{self, Write};

use comfy_table::ContentArrangement;

use super::device::{Device, Neighbour, Submodule};
use crate::cli::output::{print_json, table};
use crate::profinet::rpc::PORT;

/// The format of an inventory.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum Format {
    Text,
    Json,
    Csv,
}

/// A column: its name in CSV, its heading in the table (none: it is not there), and what stands in it.
struct Column {
    name: &'static str,
    heading: Option<&'static str>,
    cell: fn(&Device, Option<&Submodule>) -> Option<String>,
}

macro_rules! column {
    ($name:literal, $heading:expr, |$device:pat_param, $submodule:pat_param| $cell:expr) => {
        Column { name: $name, heading: $heading, cell: |$device, $submodule| $cell }
    };
}

const COLUMNS: &[Column] = &[
    column!("address", Some("Address"), |device, _| address(device)),
    column!("mac", Some("MAC address"), |device, _| Some(device.mac?.to_string())),
    column!("station_name", Some("Station"), |device, _| device.station_name.clone()),
    column!("annotation", None, |device, _| device.annotation.clone()),
    column!("vendor_id", Some("Vendor"), |device, submodule| {
        hex(submodule.and_then(|submodule| submodule.product.vendor_id).or(device.vendor_id))
    }),
    column!("device_id", Some("Device"), |device, _| hex(device.device_id)),
    column!("api", None, |_, submodule| Some(submodule?.api.to_string())),
    column!("slot", Some("Slot"), |_, submodule| Some(submodule?.slot.to_string())),
    column!("subslot", Some("Subslot"), |_, submodule| Some(subslot(submodule?.subslot))),
    column!("module_ident", None, |_, submodule| ident(submodule?.module_ident)),
    column!("submodule_ident", None, |_, submodule| ident(submodule?.submodule_ident)),
    column!("order_id", Some("Order ID"), |_, submodule| submodule?.product.order_id.clone()),
    column!("serial_number", Some("Serial number"), |_, submodule| {
        submodule?.product.serial_number.clone()
    }),
    column!("hardware_revision", Some("Hardware"), |_, submodule| {
        submodule?.product.hardware_revision.map(|revision| revision.to_string())
    }),
    column!("software_revision", Some("Software"), |_, submodule| {
        submodule?.product.software_revision.clone()
    }),
    column!("function", Some("Function"), |_, submodule| submodule?.function.clone()),
    column!("location", Some("Location"), |_, submodule| submodule?.location.clone()),
    column!("installed", Some("Installed"), |_, submodule| submodule?.installed.clone()),
    column!("descriptor", Some("Descriptor"), |_, submodule| submodule?.descriptor.clone()),
    column!("signature", None, |_, submodule| submodule?.signature.clone()),
    column!("error", None, |device, _| device.error.clone()),
];

/// Prints all devices, which stand in their order. A table is `width` columns wide at the most, if there is
/// a limit.
pub(super) fn print(
    devices: &[Device],
    format: Format,
    width: Option<u16>,
    out: &mut impl Write,
) -> io::Result<()> {
    match format {
        Format::Text => print_text(devices, width, out),
        Format::Json => devices.iter().try_for_each(|device| print_json(device, out)),
        Format::Csv => print_csv(devices, out),
    }
}

/// A row for each submodule; a device without any has one as well.
fn rows(
    device: &Device,
    is_shown: fn(&Submodule) -> bool,
) -> impl Iterator<Item = Option<&Submodule>> {
    let mut shown =
        device.submodules.iter().filter(move |submodule| is_shown(submodule)).peekable();
    let alone = shown.peek().is_none().then_some(None);
    alone.into_iter().chain(shown.map(Some))
}

/// Columns that nobody filled are left out, and so are submodules without I&M.
fn print_text(devices: &[Device], width: Option<u16>, out: &mut impl Write) -> io::Result<()> {
    if devices.is_empty() {
        return Ok(());
    }
    let has_im = |submodule: &Submodule| submodule.product.order_id.is_some();
    let rows = devices.iter().flat_map(|device| rows(device, has_im).map(move |row| (device, row)));
    let columns: Vec<_> = COLUMNS.iter().filter(|column| column.heading.is_some()).collect();
    let rows = rows.map(|(device, row)| {
        columns.iter().map(|column| (column.cell)(device, row).unwrap_or_default()).collect()
    });
    let mut rows: Vec<Vec<String>> = rows.collect();
    let mut header: Vec<_> = columns.iter().filter_map(|column| column.heading).collect();
    for index in (0..header.len()).rev() {
        if rows.iter().all(|row| row[index].is_empty()) {
            header.remove(index);
            rows.iter_mut().for_each(|row| drop(row.remove(index)));
        }
    }
    let mut table = table(header, &rows);
    if let Some(width) = width {
        table.set_content_arrangement(ContentArrangement::Dynamic).set_width(width);
    }
    writeln!(out, "{table}")?;
    print_neighbours(devices, out)?;
    for device in devices {
        if let Some(error) = &device.error {
            writeln!(out, "{}: {error}", name(device))?;
        }
        if device.submodules_left_out > 0 {
            writeln!(out, "{}: {} more submodules", name(device), device.submodules_left_out)?;
        }
    }
    Ok(())
}

/// A line for each port that has a neighbour, or that LLDP named.
fn print_neighbours(devices: &[Device], out: &mut impl Write) -> io::Result<()> {
    let rows = devices.iter().flat_map(|device| {
        let station = device.station_name.clone().unwrap_or_else(|| name(device));
        let known = device.neighbours.iter().map(neighbour);
        let alone = device.ports.iter().filter(|port| {
            !device.neighbours.iter().any(|neighbour| neighbour.port.as_ref() == Some(port))
        });
        let alone = alone.map(|port| [port.clone(), String::new(), String::new()]);
        let rows: Vec<_> = known.chain(alone).collect();
        rows.into_iter().map(move |row| [vec![station.clone()], row.into()].concat())
    });
    let rows: Vec<Vec<String>> = rows.collect();
    if rows.is_empty() {
        return Ok(());
    }
    writeln!(out, "\n{}", table(vec!["Station", "Port", "Neighbour", "Its port"], &rows))
}

/// Own port, station and port of a neighbour.
fn neighbour(neighbour: &Neighbour) -> [String; 3] {
    [&neighbour.port, &neighbour.station_name, &neighbour.their_port]
        .map(|text| text.clone().unwrap_or_default())
}

/// Address, or what else there is.
fn name(device: &Device) -> String {
    let mac = || device.mac.map(|mac| mac.to_string());
    address(device).or_else(mac).unwrap_or_default()
}

/// RFC 4180, with neighbours in one cell.
fn print_csv(devices: &[Device], out: &mut impl Write) -> io::Result<()> {
    let names = COLUMNS.iter().map(|column| column.name).chain(["neighbours"]);
    write!(out, "{}\r\n", names.collect::<Vec<_>>().join(","))?;
    for device in devices {
        for row in rows(device, |_| true) {
            let cells = COLUMNS.iter().map(|column| (column.cell)(device, row).unwrap_or_default());
            let cells: Vec<_> =
                cells.chain([neighbours(device)]).map(|cell| quoted(&cell)).collect();
            write!(out, "{}\r\n", cells.join(","))?;
        }
    }
    Ok(())
}

fn neighbours(device: &Device) -> String {
    let one = device.neighbours.iter().map(|it| {
        let [port, station, their_port] = neighbour(it);
        format!("{port} to {station} {their_port}")
    });
    one.collect::<Vec<_>>().join("; ")
}

/// A cell of CSV. A text that a spreadsheet would take for a formula gets an apostrophe in front: it
/// comes from a device, which may be anybody's.
fn quoted(cell: &str) -> String {
    let is_formula = cell.starts_with(['=', '+', '-', '@']);
    let cell = if is_formula { format!("'{cell}") } else { cell.to_owned() };
    if cell.contains([',', '"', '\r', '\n']) {
        format!("\"{}\"", cell.replace('"', "\"\""))
    } else {
        cell
    }
}

fn address(device: &Device) -> Option<String> {
    match (device.asked, device.address) {
        (Some(asked), _) if asked.port() != PORT => Some(asked.to_string()),
        (asked, address) => address.or(asked.map(|asked| *asked.ip())).map(|it| it.to_string()),
    }
}

fn hex(number: Option<u16>) -> Option<String> {
    number.map(|number| format!("{number:#06x}"))
}

fn ident(number: Option<u32>) -> Option<String> {
    number.map(|number| format!("{number:#010x}"))
}

/// Interfaces and ports have subslots from 0x8000 on, which everybody writes in this way.
fn subslot(number: u16) -> String {
    if number < 0x8000 { number.to_string() } else { format!("{number:#06x}") }
}
