"""Settings, inputs and code become files, stage by stage; what is finished is not done again.

In the order of the flow of data: log_import; bench, identify, adapt, simulate; validation and replay, which first_look
puts together; walking, transfer_study, watching; virtual robots; demo and report, which are made of all of them.
"""
