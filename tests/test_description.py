"""A description that contradicts itself, or FMI, is refused; what it means is never guessed."""

import pytest

from experiments import single
from fmu_files import PROBE_VARIABLES, description_xml, paper_fmu
from test_archive import with_description

XML = description_xml("trap", PROBE_VARIABLES)
XML3 = """<fmiModelDescription fmiVersion="3.0" modelName="trap" instantiationToken="{a}">
<CoSimulation modelIdentifier="trap"/>
<TypeDefinitions>
  <EnumerationType name="Level"><Item name="low" value="1"/><Item name="high" value="7"/></EnumerationType>
</TypeDefinitions>
<ModelVariables>
  <Float64 name="y" valueReference="1" causality="output"/>
  <UInt8 name="n" valueReference="2" causality="parameter" start="7"/>
  <Float32 name="v" valueReference="3" causality="parameter" start="1 2 3"><Dimension start="3"/></Float32>
  <Enumeration name="level" valueReference="4" declaredType="Level" causality="parameter" start="7"/>
  <String name="s" valueReference="5" causality="parameter"><Start value="a"/></String>
  <Boolean name="b" valueReference="6" causality="parameter" start="true false"><Dimension start="2"/></Boolean>
</ModelVariables>
<ModelStructure><Output valueReference="1" dependencies=""/></ModelStructure></fmiModelDescription>"""


@pytest.fixture
def fault(problems, tmp_path):
    """fault(xml) -> the error message for an FMU with this description."""

    def find(xml):
        ((key, sentence),) = problems(single(with_description(paper_fmu(tmp_path / "trap.fmu"), xml)))
        assert key == "components.one.fmu"
        return sentence

    return find


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('start="1.5"', 'start="abc"', "variable 'u' (line "),
        ('start="1.5"', 'start="1e400"', "start '1e400' is not of type Real"),
        ('start="1.5"', 'start=""', "start '' is not of type Real"),
        ('start="1.5"', 'start="1_0"', "start '1_0' is not of type Real"),
        ('start="3"', 'start="3.5"', "start '3.5' is not of type Integer"),
        ('start="3"', 'start="2147483648"', "start '2147483648' is not of type Integer"),
        ('start="true"', 'start="maybe"', "start 'maybe' is not of type Boolean"),
        ('start="1.5"', 'start="1.5" min="low"', "min 'low' is not of type Real"),
        ('start="1.5"', 'start="1.5" min="2" max="1"', "min 2.0 is greater than max 1.0"),
        ('name="u"', 'name="y"', "the name 'y' occurs twice"),
        ('name="u"', "", "has no name"),
        ('causality="input"', 'causality="inputt"', "no causality 'inputt'; did you mean 'input'?"),
        ('variability="continuous"', 'variability="steady"', "no variability 'steady'"),
        ('valueReference="0"', 'valueReference="-1"', "valueReference '-1' is not a number of 32 bits"),
        ('valueReference="0"', 'valueReference="4294967296"', "is not a number of 32 bits"),
        ('valueReference="0"', 'valueReference="u"', "is not a number of 32 bits"),
        ('valueReference="0"', "", "32 bits"),
        ('index="2"', 'index="0"', "refers to variable '0' of"),
        ('index="2"', 'index="99"', "refers to variable '99' of"),
        ('dependencies="', 'dependencies="-1 ', "refers to variable '-1' of"),
        ('index="2"', "", "refers to variable ''"),
        ('factor="1000"', 'factor="0"', "unit 'km' has the factor '0'"),
        ('m="1"', 'm="one"', "has the m 'one'"),
        ('value="7"', 'value="seven"', "has the value 'seven'"),
        ('guid="{trap}"', "", "it has no guid"),
        ('modelIdentifier="trap"', "", "has no modelIdentifier"),
        ('modelName="trap"', "", "it has no modelName"),
        ("<ModelVariables>", "<ModelVariables/><ModelVariables>", "needs one"),
    ],
)
def test_what_fmi_2_does_not_allow_is_reported(fault, old, new, words):
    assert old in XML
    sentence = fault(XML.replace(old, new, 1))
    assert "modelDescription.xml cannot be read: " in sentence
    assert words in sentence


def test_a_variable_without_a_type_does_not_take_that_of_the_one_before(fault):
    begin = XML.index("<ScalarVariable", XML.index("<ScalarVariable") + 1)
    end = XML.index("</ScalarVariable>", begin)
    sentence = fault(XML[: XML.index(">", begin) + 1] + XML[end:])
    assert "has 0 types" in sentence


def test_many_faults_are_reported_at_once_and_not_all(fault):
    sentence = fault(XML.replace('causality="', 'causality="x'))
    assert sentence.count("no causality") == 8
    assert sentence.endswith(f"; and {len(PROBE_VARIABLES) - 8} more")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('start="7"', 'start="256"', "start '256' is not of type UInt8"),
        ('start="7"', 'start="-1"', "start '-1' is not of type UInt8"),
        ('start="1 2 3"', 'start="1 2 x"', "start '1 2 x' is not of type Float32"),
        ('start="true false"', 'start="true no"', "is not of type Boolean"),
        (
            'causality="parameter" start="7"/>\n  <String',
            'causality="parameter" start="3"/>\n  <String',
            "not an item of its",
        ),
        ("<UInt8", "<UInt9", "no type 'UInt9'; did you mean 'UInt8'?"),
        ('<Output valueReference="1"', '<Output valueReference="9"', "the value reference '9', which no variable has"),
        ('instantiationToken="{a}"', "", "it has no instantiationToken"),
        *(
            ("<CoSimulation ", f'<CoSimulation fixedInternalStepSize="{step}" ', f"fixedInternalStepSize is '{step}'")
            for step in ("0", "-0.1", "quick", "INF", "NaN")
        ),
    ],
)
def test_what_fmi_3_does_not_allow_is_reported(fault, old, new, words):
    assert old in XML3
    assert words in fault(XML3.replace(old, new, 1))


@pytest.mark.parametrize(
    "old_new",
    [
        ('start="1.5"', 'start=" 1.5 "'),
        ('start="1.5"', 'start="-1.5E+3" min="-INF" max="INF"'),
        ('start="1.5"', 'start="1.5" nominal="1e3"'),
        ('start="true"', 'start="1"'),
        ('start="3"', 'start="-2147483648"'),
        ("<ModelVariables>", "<ModelVariables><!-- of the probe -->"),
        ("<Outputs>", "<!-- out --><Outputs><!-- in -->"),
        ('guid="{trap}"', 'guid=""'),
    ],
)
def test_what_fmi_allows_is_read(resolve, tmp_path, old_new):
    assert old_new[0] in XML
    assert resolve(single(with_description(paper_fmu(tmp_path / "trap.fmu"), XML.replace(*old_new, 1))))


def test_a_description_of_fmi_3_that_is_well_is_not_blamed(fault):
    """Whether there is a binary for it is another matter."""
    assert "has no binary for this platform" in fault(XML3)
