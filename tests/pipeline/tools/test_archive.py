from pipeline import profile
from pipeline.tools.archive import parts


def test_a_students_record_has_its_teachers_parameters():
    found = parts(profile.load("cpu"))
    student = found["evaluate@block_push-c_beso_two_step"].keys
    assert "cells.block_push-c_beso_two_step.source" in student
    assert "methods.c_beso.train.block_push" in student
    assert "methods.distilled.train.block_push" in student
    assert "methods.c_beso.train.block_push" not in found["evaluate@block_push-gcbc"].keys
