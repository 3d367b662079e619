//! `ferrocnc ui`: the tool's answers as pages in a browser, from a server on this computer.
//!
//! It decides nothing: each answer of the [`api`] is what a command prints with `--json`, and the
//! pages show it. What changes a board goes through the code of the command that does, with its
//! refusals, and after a question. It listens at 127.0.0.1 only, and answers only a page that it
//! has sent itself ([`guard`]).

mod answer;
mod api;
mod bench;
mod guard;
mod live;
mod stream;
mod web;

use anyhow::{Context, Result, bail};
use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::middleware::from_fn_with_state;
use axum::routing::{get, post};
use clap::Args;
use guard::Guard;
use serde_json::json;
use std::net::{Ipv4Addr, SocketAddrV4};
use std::process::{Command, Stdio};
use std::time::Duration;
use tokio::net::TcpListener;

/// Boards that are asked at once: every page keeps two streams open, and a browser six.
const THREADS: usize = 32;

/// Bytes of a drawing or a program that a page sends.
const LARGEST: usize = 64 << 20;

#[derive(Args)]
pub(crate) struct Ui {
    /// IP[:port] of the board to begin with.
    #[arg(value_name = "BOARD")]
    board: Option<String>,
    /// The port to listen at; a free one if not given.
    #[arg(long, value_name = "PORT", default_value_t = 0)]
    port: u16,
    /// Print the address only, and open no browser.
    #[arg(long)]
    no_open: bool,
    /// Bench: how long to wait for one answer of the board. Three in a row that are missing switch
    /// everything off.
    #[arg(long, value_name = "MS", default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=1000))]
    patience: u64,
}

pub(crate) fn run(arguments: &Ui, as_json: bool) -> Result<()> {
    let board = arguments.board.as_deref();
    if let Some(board) = board {
        crate::parse(board, wire::DEFAULT_PORT)?;
    }
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_io()
        .enable_time()
        .max_blocking_threads(THREADS)
        .build()
        .context("no thread for the server")?;
    runtime.block_on(serve(arguments, board, as_json))
}

async fn serve(arguments: &Ui, board: Option<&str>, as_json: bool) -> Result<()> {
    let wanted = SocketAddrV4::new(Ipv4Addr::LOCALHOST, arguments.port);
    let listener = TcpListener::bind(wanted).await.with_context(|| {
        format!("cannot listen at {wanted}; leave out --port to take a free one")
    })?;
    let guard = Guard::new(listener.local_addr()?.port())?;
    let address = guard.address(board);
    if as_json {
        println!("{}", json!({ "address": address }));
    } else {
        println!("{address}\nCtrl-C ends it.");
    }
    if !arguments.no_open && open(&address).is_err() {
        eprintln!("ferrocnc: no browser opens (xdg-open is missing): open the address yourself");
    }
    let pages = pages(guard, Duration::from_millis(arguments.patience));
    axum::serve(listener, pages).await?;
    bail!("the server has ended")
}

/// What there is, behind the guard.
fn pages(guard: Guard, patience: Duration) -> Router {
    let large = DefaultBodyLimit::max(LARGEST);
    let answers = Router::new()
        .route("/discover", get(api::discover))
        .route("/describe", get(api::describe))
        .route("/set", post(api::board_set))
        .route("/key", get(api::key_show).post(api::key_order))
        .route("/update", post(stream::update).layer(large))
        .route("/doctor", get(api::doctor))
        .route(
            "/doctor/repairs",
            get(api::doctor_repairs).post(api::doctor_repair),
        )
        .route("/watch", get(live::watch))
        .route("/log", get(live::log))
        .route("/platforms", get(api::platforms))
        .route("/config/new", post(api::config_new))
        .route("/config/check", post(api::config_check))
        .route("/config/diff", post(api::config_diff))
        .route("/config/apply", post(stream::config_apply))
        .route("/config/read", get(api::config_read))
        .route("/config/pinout", post(api::config_pinout))
        .route("/config/svg", post(api::config_svg))
        .route("/config/import", post(api::config_import))
        .route("/machine/samples", get(api::machine_samples))
        .route("/machine/new", post(api::machine_new))
        .route("/machine/check", post(api::machine_check))
        .route("/machine/put", post(api::machine_put))
        .route("/job/drawn", post(api::job_drawn).layer(large))
        .route("/job/send", post(api::job_send).layer(large))
        .route("/job/order", post(api::job_order))
        .route("/job/watch", get(live::jobs))
        .merge(bench::routes(patience))
        .fallback(web::missing);
    let base = guard.token();
    Router::new()
        .nest(&format!("/{base}/api"), answers)
        .route(&format!("/{base}/"), get(web::index))
        .route(&format!("/{base}/{{*file}}"), get(web::file))
        .fallback(web::missing)
        .layer(from_fn_with_state(guard, guard::admit))
}

/// Opens the browser of the desktop.
fn open(address: &str) -> std::io::Result<()> {
    let mut command = Command::new("xdg-open");
    command.arg(address);
    command.stdin(Stdio::null()).stdout(Stdio::null());
    let mut child = command.stderr(Stdio::null()).spawn()?;
    // It ends when the browser has the address, or with the browser.
    std::thread::spawn(move || child.wait());
    Ok(())
}
