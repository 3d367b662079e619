//! Debian's Chromium without a screen, driven as the W3C's WebDriver says, by its program
//! chromedriver.

use ferrocnc_tests::reports;
use serde_json::{Value, json};
use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Longer than any busy computer takes; a page that is right is right much sooner.
const PATIENCE: Duration = Duration::from_secs(60);
/// How WebDriver calls an element in JSON.
const ELEMENT: &str = "element-6066-11e4-a52e-4f735466cecf";
/// Its codes of keys.
pub const TAB: &str = "\u{e004}";
pub const ENTER: &str = "\u{e007}";
pub const RIGHT: &str = "\u{e014}";
pub const DOWN: &str = "\u{e015}";

/// Finds what keeps readers out; it is in no package.
const AXE: &str = include_str!("axe/axe.min.js");

/// A browser with a window; it ends with the test.
pub struct Browser {
    driver: Child,
    agent: ureq::Agent,
    session: String,
    folder: PathBuf,
}

/// Something on a page.
#[derive(Clone, Debug)]
pub struct Element(String);

impl Browser {
    /// With a profile and a folder for downloads of its own.
    pub fn start(name: &str) -> Self {
        let name = format!("ferrocnc-ui-{name}-{}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&folder).expect("a folder");
        let mut driver = Command::new("chromedriver");
        driver.arg("--port=0").stdout(Stdio::piped());
        let mut driver = driver.stderr(Stdio::null()).spawn().expect("chromedriver");
        let lines = BufReader::new(driver.stdout.take().expect("its output")).lines();
        let port = lines.map_while(Result::ok).find_map(|line| {
            let (_, port) = line.split_once("started successfully on port ")?;
            port.trim_end_matches('.').parse::<u16>().ok()
        });
        let port = port.expect("chromedriver says its port");
        let config = ureq::Agent::config_builder().http_status_as_error(false);
        let agent = config.build().new_agent();
        let session = format!("http://127.0.0.1:{port}/session");
        let mut browser = Browser {
            driver,
            agent,
            session,
            folder,
        };
        let profile = browser.folder.join("profile");
        let options = json!({
            "args": [
                // A container's root may not make the sandbox; the pages are ours.
                "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu",
                "--window-size=1280,800", format!("--user-data-dir={}", profile.display()),
            ],
            "prefs": { "download.default_directory": browser.folder },
        });
        let wanted =
            json!({ "capabilities": { "alwaysMatch": { "goog:chromeOptions": options } } });
        let made = browser.post("", &wanted);
        let id = made["sessionId"].as_str().expect("a session");
        browser.session = format!("{}/{id}", browser.session);
        browser
    }

    fn post(&self, command: &str, body: &Value) -> Value {
        self.try_post(command, body)
            .unwrap_or_else(|error| panic!("{command}: {error}"))
    }

    fn try_post(&self, command: &str, body: &Value) -> Result<Value, String> {
        let url = format!("{}{command}", self.session);
        let sent = self.agent.post(url).send(body.to_string());
        Self::value(sent)
    }

    fn get(&self, command: &str) -> Value {
        let sent = self.agent.get(format!("{}{command}", self.session)).call();
        Self::value(sent).unwrap_or_else(|error| panic!("{command}: {error}"))
    }

    fn value(sent: Result<ureq::http::Response<ureq::Body>, ureq::Error>) -> Result<Value, String> {
        let mut sent = sent.map_err(|error| error.to_string())?;
        let good = sent.status().is_success();
        let read = sent
            .body_mut()
            .with_config()
            .limit(64 << 20)
            .read_to_string();
        let text = read.map_err(|error| error.to_string())?;
        let said = serde_json::from_str(&text);
        let mut said: Value = said.map_err(|error| format!("{error}: {text}"))?;
        let value = said["value"].take();
        if good {
            Ok(value)
        } else {
            Err(value.to_string())
        }
    }

    /// Opens an address.
    pub fn open(&self, address: &str) {
        self.post("/url", &json!({ "url": address }));
    }

    /// What axe-core finds on the page that is serious or worse, with where.
    pub fn barriers(&self) -> Vec<String> {
        if self.js("return typeof axe", &[]) != "object" {
            self.js(AXE, &[]);
        }
        let script = "const done = arguments[arguments.length - 1]; \
             axe.run(document, { resultTypes: ['violations'] }).then((found) => done( \
             found.violations.filter((it) => ['serious', 'critical'].includes(it.impact)) \
             .map((it) => `${it.id}: ${it.help}: ${it.nodes.map((at) => at.html).join(' ')}`)), \
             (error) => done([String(error)]))";
        let found = self.post("/execute/async", &json!({ "script": script, "args": [] }));
        let list = found.as_array().cloned().unwrap_or_default();
        let texts = list.iter().filter_map(Value::as_str);
        texts.map(str::to_owned).collect()
    }

    /// The window of a tablet, held upright; or that of a desktop again.
    pub fn tablet(&self, is_one: bool) {
        let (command, params) = match is_one {
            true => (
                "Emulation.setDeviceMetricsOverride",
                json!({ "width": 820, "height": 1180, "deviceScaleFactor": 1, "mobile": true }),
            ),
            false => ("Emulation.clearDeviceMetricsOverride", json!({})),
        };
        let touch = json!({ "enabled": is_one });
        for (cmd, params) in [
            (command, params),
            ("Emulation.setTouchEmulationEnabled", touch),
        ] {
            self.post(
                "/goog/cdp/execute",
                &json!({ "cmd": cmd, "params": params }),
            );
        }
    }

    /// Runs a script; what it returns.
    pub fn js(&self, script: &str, arguments: &[Value]) -> Value {
        self.post(
            "/execute/sync",
            &json!({ "script": script, "args": arguments }),
        )
    }

    /// The visible text of the page.
    pub fn text(&self) -> String {
        let text = self.js("return document.body.innerText", &[]);
        text.as_str().unwrap_or_default().to_owned()
    }

    /// Waits until the page says it.
    #[track_caller]
    pub fn says(&self, words: &str) {
        self.until(&format!("the page says {words:?}"), || {
            self.text().contains(words)
        });
    }

    /// Waits for what has to come.
    #[track_caller]
    pub fn until(&self, what: &str, come: impl Fn() -> bool) {
        let begun = Instant::now();
        while !come() {
            if begun.elapsed() > PATIENCE {
                self.picture("failed");
                panic!("not so: {what}; the page:\n{}", self.text());
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// The first element of this CSS selector, once it is there.
    #[track_caller]
    pub fn find(&self, css: &str) -> Element {
        self.until(&format!("there is {css}"), || !self.all(css).is_empty());
        self.all(css).swap_remove(0)
    }

    /// All elements of this CSS selector.
    pub fn all(&self, css: &str) -> Vec<Element> {
        let wanted = json!({ "using": "css selector", "value": css });
        let found = self.post("/elements", &wanted);
        let list = found.as_array().cloned().unwrap_or_default();
        let ids = list.iter().filter_map(|it| it[ELEMENT].as_str());
        ids.map(|id| Element(id.to_owned())).collect()
    }

    /// The button with these words, by its accessible name.
    #[track_caller]
    pub fn button(&self, name: &str) -> Element {
        let found = || {
            let mut all = self.all("button").into_iter();
            all.find(|it| self.label(it).starts_with(name))
        };
        self.until(&format!("there is the button {name}"), || found().is_some());
        found().expect("it is there")
    }

    pub fn click(&self, element: &Element) {
        self.post(&format!("/element/{}/click", element.0), &json!({}));
    }

    /// Types into it; a path into a chooser of files.
    pub fn write(&self, element: &Element, text: &str) {
        let path = format!("/element/{}/value", element.0);
        self.post(&path, &json!({ "text": text }));
    }

    /// Replaces what is in a field, as an edit by hand does.
    pub fn fill(&self, css: &str, text: &str) {
        let script = "const [it, text] = arguments; it.value = text; \
                      it.dispatchEvent(new Event('input', { bubbles: true }))";
        let element = json!({ ELEMENT: self.find(css).0 });
        self.js(script, &[element, json!(text)]);
    }

    /// Takes this value of a list.
    pub fn choose(&self, css: &str, value: &str) {
        let script = "const [it, value] = arguments; it.value = value; \
                      it.dispatchEvent(new Event('change', { bubbles: true }))";
        let element = json!({ ELEMENT: self.find(css).0 });
        self.js(script, &[element, json!(value)]);
    }

    /// The same for the field whose label begins so.
    #[track_caller]
    pub fn fill_labelled(&self, label: &str, text: &str) {
        let script = "const [label, text] = arguments; \
             const all = [...document.querySelectorAll('label')]; \
             const it = all.find((it) => it.textContent.startsWith(label))?.querySelector('input'); \
             if (!it) return false; it.value = text; \
             it.dispatchEvent(new Event('input', { bubbles: true })); return true";
        self.until(&format!("there is the field {label}"), || {
            self.js(script, &[json!(label), json!(text)]) == true
        });
    }

    /// Opens the part of the page that is called so.
    #[track_caller]
    pub fn open_part(&self, name: &str) {
        let script = "const it = [...document.querySelectorAll('summary')] \
             .find((it) => it.textContent === arguments[0]); \
             if (it) it.parentElement.open = true; return Boolean(it)";
        self.until(&format!("there is {name}"), || {
            self.js(script, &[json!(name)]) == true
        });
    }

    /// What is in a field.
    pub fn value_of(&self, css: &str) -> String {
        let element = json!({ ELEMENT: self.find(css).0 });
        let value = self.js("return arguments[0].value", &[element]);
        value.as_str().unwrap_or_default().to_owned()
    }

    /// Presses keys, wherever the focus is.
    pub fn press(&self, keys: &str) {
        let mut actions = Vec::new();
        for key in keys.chars() {
            for kind in ["keyDown", "keyUp"] {
                actions.push(json!({ "type": kind, "value": key }));
            }
        }
        let keyboard = json!({ "type": "key", "id": "keyboard", "actions": actions });
        self.post("/actions", &json!({ "actions": [keyboard] }));
    }

    /// What has the focus, as a screen reader names it.
    pub fn focused(&self) -> String {
        let active = self.get("/element/active");
        let id = active[ELEMENT].as_str().expect("an element");
        self.label(&Element(id.to_owned()))
    }

    /// The accessible name.
    pub fn label(&self, element: &Element) -> String {
        let label = self.try_get(&format!("/element/{}/computedlabel", element.0));
        label.as_str().unwrap_or_default().to_owned()
    }

    /// It is on the page, and not in a part that is closed.
    pub fn is_shown(&self, element: &Element) -> bool {
        self.try_get(&format!("/element/{}/displayed", element.0)) == true
    }

    /// The accessible role.
    pub fn role(&self, element: &Element) -> String {
        let role = self.try_get(&format!("/element/{}/computedrole", element.0));
        role.as_str().unwrap_or_default().to_owned()
    }

    /// Nothing for an element that the page has replaced meanwhile.
    fn try_get(&self, command: &str) -> Value {
        let sent = self.agent.get(format!("{}{command}", self.session)).call();
        Self::value(sent).unwrap_or_default()
    }

    /// Drops a file onto the page, as a mouse does.
    pub fn drop_file(&self, name: &str, content: &str) {
        let script = "const [name, content] = arguments; const data = new DataTransfer(); \
             data.items.add(new File([content], name)); \
             document.querySelector('main > div').dispatchEvent( \
             new DragEvent('drop', { dataTransfer: data, bubbles: true, cancelable: true }))";
        self.js(script, &[json!(name), json!(content)]);
    }

    /// The text of a file that was downloaded, once it is there.
    #[track_caller]
    pub fn downloaded(&self, name: &str) -> String {
        let path = self.folder.join(name);
        // The browser first makes an empty file, to have the name.
        let is_there = || path.metadata().is_ok_and(|file| file.len() > 0);
        self.until(&format!("{name} is downloaded"), is_there);
        std::fs::read_to_string(&path).expect("a text")
    }

    /// Light or dark, as the system's setting.
    pub fn scheme(&self, scheme: &str) {
        let features = json!([{ "name": "prefers-color-scheme", "value": scheme }]);
        let command =
            json!({ "cmd": "Emulation.setEmulatedMedia", "params": { "features": features } });
        self.post("/goog/cdp/execute", &command);
    }

    /// On paper or on a screen.
    pub fn medium(&self, medium: &str) {
        let command = json!({ "cmd": "Emulation.setEmulatedMedia", "params": { "media": medium } });
        self.post("/goog/cdp/execute", &command);
    }

    /// The page as a PDF, in base64, as its print dialog makes it.
    pub fn pdf(&self) -> String {
        let params = json!({ "preferCSSPageSize": true, "printBackground": true });
        let script = json!({ "cmd": "Page.printToPDF", "params": params });
        let made = self.post("/goog/cdp/execute", &script);
        made["data"].as_str().unwrap_or_default().to_owned()
    }

    /// Drags one element onto another, as a mouse does.
    pub fn drag(&self, from: &Element, to: &Element) {
        let script = "const [from, to] = arguments; const dataTransfer = new DataTransfer(); \
             const send = (kind, it) => it.dispatchEvent(new DragEvent(kind, \
             { dataTransfer, bubbles: true, cancelable: true })); \
             if (!from.draggable) return false; send('dragstart', from); \
             const isTaken = !send('dragover', to); if (isTaken) send('drop', to); return isTaken";
        let [from, to] = [from, to].map(|it| json!({ ELEMENT: it.0 }));
        assert_eq!(self.js(script, &[from, to]), true, "it is taken there");
    }

    /// What the browser has complained of: scripts that failed, files that were refused.
    pub fn complaints(&self) -> Vec<String> {
        let said = self.post("/se/log", &json!({ "type": "browser" }));
        let list = said.as_array().cloned().unwrap_or_default();
        let texts = list.iter().filter_map(|it| it["message"].as_str());
        texts.map(str::to_owned).collect()
    }

    /// Leaves a picture of the window in the reports.
    pub fn picture(&self, name: &str) {
        let to = reports().join(format!("ui-{name}.png"));
        let script = json!({ "cmd": "Page.captureScreenshot", "params": {} });
        let taken = self.post("/goog/cdp/execute", &script);
        let _ = std::fs::create_dir_all(reports());
        write_base64(&to, taken["data"].as_str().unwrap_or_default());
    }
}

/// Writes what base64 says; the tool of every Debian reads it.
fn write_base64(to: &Path, text: &str) {
    use std::io::Write as _;
    let file = std::fs::File::create(to).expect("a file");
    let mut decode = Command::new("base64");
    decode.arg("-d").stdin(Stdio::piped()).stdout(file);
    let mut decode = decode.spawn().expect("base64 of coreutils");
    let written = decode
        .stdin
        .take()
        .map(|mut it| it.write_all(text.as_bytes()));
    written.expect("its input").expect("it reads");
    decode.wait().expect("it ends");
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.agent.delete(self.session.clone()).call();
        let _ = self.driver.kill();
        let _ = self.driver.wait();
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}
