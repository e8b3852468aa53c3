"""Dimensioned drawings of the part: views on drawing boards, laid out on sheets of paper, as DXF and PDF.

The report shows the same views. Every number is measured on the faces that are traced and written.
"""
