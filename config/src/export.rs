//! A configuration as JSON: what `gateware/ferrocnc/board.py` loads. Everything is resolved and
//! checked; balls, not pins.

use crate::blob::blob;
use crate::board::{Board, Class};
use crate::error::Error;
use crate::platform::{Level, Platform};
use serde_json::{Map, Value, json};

/// The JSON, keys in the order of the files.
pub fn export(board: &Board) -> Result<Value, Error> {
    let blob: String = blob(board)?
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect();
    let mut out = json!({
        "file": board.file,
        "name": board.name,
        "platform": platform(&board.platform, board.phy),
        "sys_clk_hz": board.sys_clk_hz,
        "phy": board.phy,
        "mac": board.mac,
        "ipv4": board.ipv4,
        "udp_port": board.udp_port,
        "ext_reset": { "pin": board.ext_reset.pin, "active_low": board.ext_reset.active == Level::Low },
        "factory": {
            "pin": board.factory.as_ref().and_then(|line| line.pin.as_ref()),
            "active_low": board.factory.as_ref().is_none_or(|line| line.active == Level::Low),
        },
        "jobs": board.jobs,
        "sdram": board.sdram,
        "safe_mask": board.safe_mask(),
        "invert_mask": board.invert_mask(),
        "missing_pins": board.missing_pins(),
        "blob": blob,
    });
    for class in Class::ALL {
        out[class.key()] = board
            .of(class)
            .iter()
            .map(|channel| {
                let mut entry = Map::new();
                entry.insert("name".to_owned(), json!(channel.name));
                if !channel.kind.is_empty() {
                    entry.insert("type".to_owned(), json!(channel.kind));
                }
                for (key, _, _) in class.pins() {
                    entry.insert((*key).to_owned(), json!(channel.pin(key)));
                }
                match class {
                    Class::Input => {
                        entry.insert("estop".to_owned(), json!(channel.estop.map(Level::word)))
                    }
                    Class::Output => {
                        entry.insert("safe".to_owned(), json!(channel.safe.map(Level::word)))
                    }
                    Class::Stepgen | Class::Encoder | Class::Pwm => None,
                };
                Value::Object(entry)
            })
            .collect();
    }
    Ok(out)
}

fn platform(platform: &Platform, phy: usize) -> Value {
    let pins: Map<String, Value> = platform
        .pins()
        .map(|(name, ball)| (name, json!(ball)))
        .collect();
    let ethernet = platform.phys.get(phy).map(|phy| {
        json!({
            "tx_clk": phy.tx_clk, "rx_clk": phy.rx_clk, "mdio": platform.mdio[0], "mdc": platform.mdio[1],
            "rx_ctl": phy.rx_ctl, "rx_data": phy.rx_data.join(" "), "tx_ctl": phy.tx_ctl, "tx_data": phy.tx_data.join(" "),
        })
    });
    let [cs, mosi, miso] = &platform.flash_balls;
    json!({
        "file": platform.file, "name": platform.name, "title": platform.title, "device": platform.device, "package": platform.package,
        "clock": { "ball": platform.clock_ball, "hz": platform.clock_hz },
        "led": { "ball": platform.led_ball, "active_low": platform.led_active == Level::Low },
        "ethernet": ethernet,
        "phy_reset": platform.phy_reset,
        "flash": { "cs": cs, "mosi": mosi, "miso": miso, "bytes": platform.flash_bytes },
        "sdram": platform.sdram.as_ref().map(|sdram| json!({
            "chip": sdram.chip, "clk": sdram.clk, "we": sdram.we, "ras": sdram.ras, "cas": sdram.cas,
            "ba": sdram.ba.join(" "), "a": sdram.a.join(" "), "dq": sdram.dq.join(" "),
        })),
        "pins": pins,
    })
}
