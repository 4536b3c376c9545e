"""Formats that are more than a table in text."""

from pathlib import Path

from .form import HEIGHT, TIME, form, rows


@form(
    "measurement.lvm",
    after="LabVIEW measurement, with times",
    source="https://www.ni.com/en/support/documentation/supplemental/06/specification-for-the-labview-measurement-file---lvm-.html",
)
def labview(path: Path) -> None:
    head = LABVIEW.format(x_columns="One", mark=".")
    path.write_bytes(
        (
            "\r\n".join(
                [*head.split("\n"), "X_Value\tHeight\tComment", *map("\t".join, rows(9, scale=1.0)), ""]
            )
        ).encode()
    )


@form(
    "no_times.lvm",
    after="LabVIEW measurement without times and with decimal commas",
    source="https://www.ni.com/en/support/documentation/supplemental/06/specification-for-the-labview-measurement-file---lvm-.html",
)
def labview_without_times(path: Path) -> None:
    head = LABVIEW.format(x_columns="No", mark=",").replace("0.01", "0,01").replace("0.0", "0,0")
    body = ["\t" + z for _, z in rows(9, mark=",", scale=1.0)]
    path.write_bytes(("\r\n".join([*head.split("\n"), "X_Value\tHeight\tComment", *body, ""])).encode())


LABVIEW = """LabVIEW Measurement\t
Writer_Version\t2
Reader_Version\t2
Separator\tTab
Decimal_Separator\t{mark}
Multi_Headings\tNo
X_Columns\t{x_columns}
Time_Pref\tRelative
Operator\tAda
Date\t2024/05/01
Time\t12:00:00.0
***End_of_Header***\t
\t
Channels\t1\t
Samples\t80\t
Date\t2024/05/01\t
Time\t12:00:00.0\t
Y_Unit_Label\tm\t
X_Dimension\tTime\t
X0\t0.0E+0\t
Delta_X\t0.01\t
***End_of_Header***\t\t"""


@form(
    "matlab.mat",
    after="MATLAB 5 file of vectors",
    source="https://www.mathworks.com/help/pdf_doc/matlab/matfile_format.pdf",
)
def matlab(path: Path) -> None:
    import scipy.io

    scipy.io.savemat(path, {"t": TIME[:, None], "z": HEIGHT[:, None], "note": "run 7"})


@form(
    "structure.mat",
    after="MATLAB 5 file of a structure",
    source="https://www.mathworks.com/help/pdf_doc/matlab/matfile_format.pdf",
)
def matlab_structure(path: Path) -> None:
    import scipy.io

    scipy.io.savemat(path, {"run7": {"time": TIME, "height_mm": 1e3 * HEIGHT}})


@form("frame.parquet", after="pandas, to_parquet", source="https://parquet.apache.org/docs/file-format/")
def parquet(path: Path) -> None:
    import pandas

    pandas.DataFrame({"time [ms]": 1e3 * TIME, "height [mm]": 1e3 * HEIGHT}).to_parquet(path)


@form(
    "book.xlsx",
    after="Excel, by openpyxl; a sheet of notes before the table",
    source="https://ecma-international.org/publications-and-standards/standards/ecma-376/",
)
def excel(path: Path) -> None:
    import openpyxl

    book = openpyxl.Workbook()
    book.active.append(["Measured by", "Ada"])
    sheet = book.create_sheet("run 7")
    sheet.append(["piston A"])
    sheet.append(["time [s]", "height [mm]"])
    for t, z in zip(TIME, HEIGHT, strict=True):
        sheet.append([float(t), float(1e3 * z)])
    book.save(path)


@form(
    "book.xls",
    after="Excel 97 to 2003, as phyphox may write it, by xlwt",
    source="https://learn.microsoft.com/en-us/openspecs/windows_protocols/ms-cfb/",
)
def old_excel(path: Path) -> None:
    import xlwt

    book = xlwt.Workbook()
    sheet = book.add_sheet("run 7")
    for row, cells in enumerate([("time [s]", "height [mm]"), *zip(TIME, 1e3 * HEIGHT, strict=True)]):
        for column, cell in enumerate(cells):
            sheet.write(row, column, cell if isinstance(cell, str) else float(cell))
    book.save(path)


@form(
    "book.ods",
    after="LibreOffice, by odfpy",
    source="https://docs.oasis-open.org/office/OpenDocument/v1.3/os/part3-schema/OpenDocument-v1.3-os-part3-schema.html",
)
def libre_office(path: Path) -> None:
    import pandas

    frame = pandas.DataFrame({"time [s]": TIME, "height [mm]": 1e3 * HEIGHT})
    frame.to_excel(path, index=False, engine="odf")


@form(
    "measurement.tdms",
    after="National Instruments TDMS, by npTDMS",
    source="https://www.ni.com/en/support/documentation/supplemental/07/tdms-file-format-internal-structure.html",
)
def tdms(path: Path) -> None:
    from nptdms import ChannelObject, TdmsWriter

    properties = {"wf_increment": 0.01, "wf_start_offset": 0.0, "unit_string": "mm"}
    with TdmsWriter(str(path)) as writer:
        writer.write_segment([ChannelObject("run 7", "Height", 1e3 * HEIGHT, properties)])
