from pipeline import profile
from pipeline.tools.archive import parts


def test_a_students_record_has_its_teachers_parameters():
    found = parts(profile.load("cpu"))
    student = found["evaluate@block_push-c_beso_two_step"].parameters
    assert student["train.teacher"] == "c_beso"
    assert student["train.first.config.optimization.steps"] == 3000
    assert student["teacher.first.config.optimization.steps"] == 13000
    assert not any(key.startswith("teacher") for key in found["evaluate@block_push-gcbc"].parameters)
