//! Plücker lines: incidence, transformation, projection, triangulation and their manifold.

mod support;

use geometry::line::{d_moment_d_pluecker, triangulate, triangulate_many, triangulate_with_direction};
use geometry::nalgebra::{SVector, Vector3, Vector4};
use geometry::{Direction, Line3, OrthonormalLine, Pinhole, Pose, Similarity};
use rand::Rng;
use support::{assert_close, generators, numeric_jacobian, point_in_view, uniform, unit_vector};

/// How far apart two lines are: angle of directions and distance of a point of one from the other.
fn line_error(a: &Line3, b: &Line3) -> f64 {
    a.direction().cross(b.direction()).norm().max(a.distance(&b.origin())).max(b.distance(&a.origin()))
}

fn random_line(rng: &mut impl Rng) -> Line3 {
    Line3::from_points(&point_in_view(rng), &point_in_view(rng)).expect("two different points")
}

/// The unit normal of the plane a camera and two world points span, from what the camera sees of them.
fn interpretation_normal(pose: &Pose, a: &Vector3<f64>, b: &Vector3<f64>) -> Vector3<f64> {
    pose.transform(a).cross(&pose.transform(b)).normalize()
}

#[test]
fn lines_contain_the_points_they_are_made_of() {
    for (seed, mut rng) in generators("line_points", 50) {
        let (a, b) = (point_in_view(&mut rng), point_in_view(&mut rng));
        let line = Line3::from_points(&a, &b).unwrap();
        assert!(line.distance(&a).max(line.distance(&b)) < 1e-13, "seed {seed}");
        assert!(line.moment().dot(line.direction()).abs() < 1e-13);
        assert_close(&line.at(line.parameter_of(&a)), &a, 1e-13, "parameter");
        assert!((line.distance(&Vector3::zeros()) - line.moment().norm()).abs() < 1e-13);
        let scaled = Line3::from_pluecker(&(line.moment() * 3.0), &(line.direction() * 3.0)).unwrap();
        assert!(line_error(&scaled, &line) < 1e-13);
        let parameter = line.parameter_nearest_to_ray(&Vector3::zeros(), &b.normalize()).unwrap();
        assert_close(&line.at(parameter), &b, 1e-10, "the ray to a point of the line meets it there");
    }
    assert_eq!(Line3::from_points(&Vector3::x(), &Vector3::x()), None);
    assert_eq!(Line3::from_points(&Vector3::x(), &Vector3::repeat(f64::NAN)), None);
    let along_x = Line3::from_point_direction(&Vector3::z(), &Vector3::x()).unwrap();
    assert_eq!(along_x.parameter_nearest_to_ray(&Vector3::zeros(), &Vector3::x()), None);
}

#[test]
fn transformed_lines_contain_the_transformed_points() {
    for (seed, mut rng) in generators("line_transform", 50) {
        let (a, b) = (point_in_view(&mut rng), point_in_view(&mut rng));
        let line = Line3::from_points(&a, &b).unwrap();
        let pose = support::pose(&mut rng, 3.0, 4.0);
        let expected = Line3::from_points(&(pose * a), &(pose * b)).unwrap();
        assert!(line_error(&(pose * line), &expected) < 1e-12, "seed {seed}");
        let similarity = Similarity::exp(&uniform(&mut rng, 1.0));
        let expected = Line3::from_points(&(similarity * a), &(similarity * b)).unwrap();
        assert!(line_error(&(similarity * line), &expected) < 1e-12, "seed {seed}");

        let pluecker: SVector<f64, 6> =
            SVector::from_fn(|i, _| if i < 3 { line.moment()[i] } else { line.direction()[i - 3] });
        assert_close(&(d_moment_d_pluecker(&pose) * pluecker), (pose * line).moment(), 1e-13, "[R, [t]x R]");
    }
}

#[test]
fn projected_points_lie_on_the_projected_line() {
    let camera = Pinhole { fx: 458.0, fy: 457.0, cx: 367.0, cy: 248.0 };
    for (seed, mut rng) in generators("line_projection", 50) {
        let (a, b) = (point_in_view(&mut rng), point_in_view(&mut rng));
        let image_line = Line3::from_points(&a, &b).unwrap().image_line(&camera);
        assert_close(
            &image_line,
            &(camera.line_matrix() * Line3::from_points(&a, &b).unwrap().moment()),
            1e-12,
            "K_L",
        );
        for point in [a, b] {
            let distance = camera.project(&point).push(1.0).dot(&image_line) / image_line.xy().norm();
            assert!(distance.abs() < 1e-9, "seed {seed}: {distance:e} px");
        }
    }
}

#[test]
fn lines_are_triangulated_from_two_and_more_views() {
    for (seed, mut rng) in generators("line_triangulation", 200) {
        let (a, b) = (point_in_view(&mut rng), point_in_view(&mut rng));
        let truth = Line3::from_points(&a, &b).unwrap();
        let views: Vec<_> = (0..4)
            .map(|_| {
                let pose = support::pose(&mut rng, 0.3, 1.0);
                (pose, interpretation_normal(&pose, &a, &b))
            })
            .collect();
        let angle_deg = {
            let normals = [0, 1].map(|i| views[i].0.rotation.inverse() * views[i].1);
            normals[0].cross(&normals[1]).norm().asin().to_degrees()
        };
        let two = triangulate(&views[0].0, &views[0].1, &views[1].0, &views[1].1).unwrap();
        assert!(
            line_error(&two, &truth) < 1e-10 / angle_deg.min(1.0).powi(2),
            "seed {seed}: {angle_deg} deg"
        );
        let many = triangulate_many(&views, 5.0).unwrap();
        assert!(line_error(&many.line, &truth) < 1e-6, "seed {seed}: {:e}", line_error(&many.line, &truth));
        assert!(many.rank_ratio < 1e-5, "seed {seed}: {:e}", many.rank_ratio);
        let direction = Direction::new(*truth.direction()).unwrap();
        let known = triangulate_with_direction(&views, &direction).unwrap();
        assert!(line_error(&known, &truth) < 1e-8, "seed {seed}: {:e}", line_error(&known, &truth));
    }
}

#[test]
fn coinciding_planes_are_refused() {
    // The baseline is along the line: both cameras see it in the same plane.
    let (a, b) = (Vector3::new(-1.0, 1.0, 4.0), Vector3::new(1.0, 1.0, 4.0));
    let views = [0.0, 0.5].map(|x| {
        let pose = Pose::new(Pose::identity().rotation, Vector3::new(x, 0.0, 0.0));
        (pose, interpretation_normal(&pose, &a, &b))
    });
    assert_eq!(triangulate(&views[0].0, &views[0].1, &views[1].0, &views[1].1), None);
    assert_eq!(triangulate_many(&views, 4.0), None);
    assert_eq!(triangulate_with_direction(&views, &Direction::new(Vector3::x()).unwrap()), None);
}

#[test]
fn orthonormal_lines_obey_the_manifold_laws() {
    for (seed, mut rng) in generators("orthonormal_laws", 200) {
        let line = random_line(&mut rng);
        let form = OrthonormalLine::from_line(&line).unwrap();
        assert!(line_error(&form.to_line().unwrap(), &line) < 1e-12, "seed {seed}");
        let unchanged = form.retract(&Vector4::zeros()).to_line().unwrap();
        assert!(line_error(&unchanged, &line) < 1e-12, "seed {seed}");
        let delta: Vector4<f64> = uniform(&mut rng, 0.5);
        assert_close(&form.local(&form.retract(&delta)), &delta, 1e-12, &format!("seed {seed}"));
        let other = OrthonormalLine::from_line(&random_line(&mut rng)).unwrap();
        let reached = form.retract(&form.local(&other)).to_line().unwrap();
        assert!(line_error(&reached, &other.to_line().unwrap()) < 1e-9, "seed {seed}");
        let reversed = Line3::from_pluecker(&-line.moment(), &-line.direction()).unwrap();
        let reversed = OrthonormalLine::from_line(&reversed).unwrap();
        assert!(form.local(&reversed).norm() < 1e-7, "seed {seed}: the sign of a line does not matter");
    }
    let through_origin = Line3::from_point_direction(&Vector3::zeros(), &Vector3::x()).unwrap();
    assert_eq!(OrthonormalLine::from_line(&through_origin), None);
}

#[test]
fn orthonormal_jacobian_matches_central_differences() {
    for (seed, mut rng) in generators("orthonormal_jacobian", 50) {
        let form = OrthonormalLine::from_line(&random_line(&mut rng)).unwrap();
        let form = form.retract(&uniform(&mut rng, 0.3));
        let numeric = numeric_jacobian(
            |delta| {
                let (n, v) = form.retract(delta).pluecker();
                SVector::<f64, 6>::from([n.x, n.y, n.z, v.x, v.y, v.z])
            },
            &Vector4::zeros(),
            1e-6,
        );
        assert_close(&form.jacobian(), &numeric, 1e-9, &format!("seed {seed}"));
    }
    // Keeps the helper honest: a unit vector has unit length.
    for (_, mut rng) in generators("unit", 3) {
        assert!((unit_vector(&mut rng).norm() - 1.0).abs() < 1e-15);
    }
}

#[test]
fn stored_lines_and_directions_come_back_bit_for_bit_and_others_are_refused() {
    for (seed, mut rng) in generators("stored", 100) {
        let line = random_line(&mut rng);
        assert_eq!(Line3::from_stored(*line.moment(), *line.direction()), Some(line), "seed {seed}");
        let direction = Direction::new(*line.direction()).unwrap();
        assert_eq!(Direction::from_stored(*direction.as_vector()), Some(direction), "seed {seed}");
        assert_eq!(Direction::from_stored(-direction.as_vector()), None, "seed {seed}: the other sign");
        assert_eq!(Direction::from_stored(direction.as_vector() * 1.001), None, "seed {seed}");
        assert_eq!(Line3::from_stored(*line.moment(), line.direction() * 1.001), None, "seed {seed}");
        let along = line.moment() + line.direction();
        assert_eq!(
            Line3::from_stored(along, *line.direction()),
            None,
            "seed {seed}: a moment along the line"
        );
    }
    let infinite = Vector3::new(0.0, 0.0, f64::INFINITY);
    assert_eq!(Line3::from_stored(infinite, Vector3::x()), None);
    assert_eq!(Direction::from_stored(infinite), None);
}
