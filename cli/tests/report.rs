//! The command `monoslam report` against a real server. That the page works in a browser is tested with the
//! viewer.

mod stage;

use std::fs;

use stage::{Stage, refusal, summary, text};

#[tokio::test(flavor = "multi_thread")]
async fn a_session_becomes_one_page_with_everything_in_it() {
    let stage = Stage::set(60).await;
    let room = stage.path("room");
    let streamed =
        stage.stream(text(&room), "room", &["--deterministic", "--seed", "1"]).output().await.unwrap();
    let told = summary(&streamed);
    let (page, plots, printed) = (stage.path("room.html"), stage.path("plots"), stage.path("stream.json"));
    fs::write(&printed, &streamed.stdout).unwrap();
    let truth = stage.path("room/groundtruth.txt");
    let words = ["report", "room", "--truth", text(&truth), "--summary", text(&printed), "--pictures", "3"];
    let words = [&words[..], &["--plots", text(&plots), "-o", text(&page)]].concat();
    let output = stage.monoslam(&words).output().await.unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));

    let html = fs::read_to_string(&page).unwrap();
    let points = format!("<dt>points</dt><dd>{}</dd>", told["points"]);
    for wanted in ["<h1>Session room</h1>", &points, "<dt>ATE RMSE</dt>", "<dt>fx</dt>", "id=\"report-data\""]
    {
        assert!(html.contains(wanted), "{wanted}");
    }
    assert_eq!(html.matches("data-keyframe=").count(), 3);
    assert!(!html.contains("src=\"http") && !html.contains("href=\"http"));
    let mut names: Vec<String> = fs::read_dir(&plots)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    let expected = ["error", "graph", "stages", "states", "trajectory-above", "trajectory-side"];
    assert_eq!(names, expected.map(|name| format!("{name}.svg")));
    for name in names {
        let svg = fs::read_to_string(plots.join(&name)).unwrap();
        assert!(svg.starts_with("<svg") && svg.ends_with("</svg>\n") && !svg.contains("NaN"), "{name:?}");
    }
    stage.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_that_is_not_there_is_told() {
    let stage = Stage::set(1).await;
    let page = stage.path("nobody.html");
    let said = refusal(&stage.monoslam(&["report", "nobody", "-o", text(&page)]).output().await.unwrap());
    assert!(said.contains("nobody") && !page.exists(), "{said}");
    stage.end().await;
}
