use super::*;
use crate::cores::Setting;
use crate::fake::*;
use proptest::prelude::*;
use wire::auth::Purpose;
use wire::describe::Channels;
use wire::exchange::{Command, Latch, PWM_ENABLE, STATUS_MAX, Status};
use wire::map::{BoardConfig, StepgenConfig};
use wire::regmap::{command, timebase};
use wire::units::{Accel, Clocks, Count, Position, Velocity};
use wire::{FaultReason, State};

mod etherbone;
mod exchange;
mod permissions;
mod segments;
mod settings;
mod stops;
mod windows;

const HEADER: u32 = 0x4e6f_1044;
