"""Which effects does the model lack?"""
